"""Reads a .rrd with rerun's own package and prints what it holds as JSON: python3 rerun_check.py FILE"""

import json
import sys

import rerun
from rerun.experimental import RrdReader

KIND = b"rerun:kind"


def kind(field):
    return (field.metadata or {}).get(KIND)


reader = RrdReader(sys.argv[1])
recordings = reader.recordings()
found = {
    "version": rerun.__version__,
    "applications": [r.application_id for r in recordings],
    "recordings": [r.recording_id for r in recordings],
    "timelines": [],
    "entities": {},
    "views": [],
    "timeline_shown": None,
}

for chunk in reader.stream():
    batch = chunk.to_record_batch()
    timelines = [f.name for f in batch.schema if kind(f) == b"index"]
    found["timelines"] = sorted({*found["timelines"], *timelines})
    entity = found["entities"].setdefault(
        str(chunk.entity_path), {"rows": 0, "last_s": None, "components": [], "values": []}
    )
    components = [f.name for f in batch.schema if kind(f) not in (b"index", b"control")]
    entity["components"] = sorted({*entity["components"], *components})
    if "t" not in timelines:
        continue
    entity["rows"] += len(chunk)
    last = max(t.value for t in batch.column(batch.schema.get_field_index("t"))) * 1e-9
    entity["last_s"] = max(last, entity["last_s"] or 0.0)
    if "Scalars:scalars" in components:
        column = batch.column(batch.schema.get_field_index("Scalars:scalars"))
        entity["values"] += [row[0] for row in column.to_pylist()]

for blueprint in reader.blueprints():
    for chunk in reader.stream(store=blueprint):
        batch = chunk.to_record_batch()
        path = str(chunk.entity_path)
        get = lambda name: batch.column(batch.schema.get_field_index(name)).to_pylist()[-1][0]
        if "ViewBlueprint:display_name" in batch.schema.names:
            found["views"].append([get("ViewBlueprint:display_name"), get("ViewBlueprint:space_origin")])
        if path == "/time_panel":
            found["timeline_shown"] = get("TimePanelBlueprint:timeline")

json.dump(found, sys.stdout)
