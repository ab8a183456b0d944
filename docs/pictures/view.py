"""The README's picture of a run in rerun's viewer: python3 docs/pictures/view.py runs/ID/run.rrd

Needs rerun-sdk 0.36.3, Pillow, and a Vulkan driver (without a graphics card: the package mesa-vulkan-drivers).
"""

import subprocess
import sys
import tempfile
from pathlib import Path
from time import sleep

from PIL import Image
from rerun.experimental import ViewerClient

ADDRESS = "rerun+http://127.0.0.1:9876/proxy"
BAR = 29  # height of the viewer's own bar

# The program itself, and not the script around it, which would outlive its end.
program = Path(sys.modules["rerun"].__file__).parents[1] / "rerun_cli" / "rerun"
viewer = subprocess.Popen([program, "--headless", "--window-size", "1280x760", sys.argv[1]])
try:
    sleep(15)  # until it has loaded, and its notices are gone
    with tempfile.TemporaryDirectory() as folder:
        shot = Path(folder) / "shot.png"
        ViewerClient(ADDRESS).save_screenshot(str(shot))
        sleep(3)  # the viewer writes it after that has returned
        image = Image.open(shot).convert("RGB")
finally:
    viewer.terminate()
    viewer.wait()
image = image.crop((0, BAR, *image.size)).quantize(256, method=Image.Quantize.MAXCOVERAGE)
image.save(Path(__file__).with_name("rerun.png"), optimize=True)
