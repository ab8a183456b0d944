# What the peers' scripts share. The task comes as JSON on stdin; every answer is a line of JSON on stdout, the first one names
# the package and its version. What packages print themselves goes to stderr. A time is the processor time of the solve
# alone, the least of several: neither the interpreter's start nor the model's assembly is in it.
import importlib
import json
import os
import sys
import time

OUT = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)
TASK = json.load(sys.stdin)


def tell(**answer):
    print(json.dumps(answer), file=OUT, flush=True)


def package(name):
    """The package, or the end of the script: freerig then says how to install it."""
    try:
        found = importlib.import_module(name)
    except ImportError:
        tell(missing=name)
        sys.exit(0)
    tell(package=name, version=found.__version__)
    return found


def best(prepare, budget=0.2):
    """What the prepared solve answers, and the least time of as many as fit into the budget (s)."""
    begun, least = time.perf_counter(), float("inf")
    while True:
        solve = prepare()
        before = time.process_time()
        answer = solve()
        least = min(least, time.process_time() - before)
        if time.perf_counter() - begun > budget:
            return answer, least
