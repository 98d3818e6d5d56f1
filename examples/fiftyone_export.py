"""Show the kept images of a run with its detections in FiftyOne: python examples/fiftyone_export.py runs/seen images"""

import sys
from pathlib import Path

import fiftyone

from fbench.api.runs import open_run
from fbench.reports.boxes import box_rows

run, folder = open_run(sys.argv[1]).run, Path(sys.argv[2]).resolve()
folder.mkdir(parents=True, exist_ok=True)
dataset, rig = fiftyone.Dataset(f"{run.manifest.log.name} {run.manifest.pipeline}", overwrite=True), run.manifest.rig
for kept in run.media:
    rows = box_rows(run.detections.at(kept.index), rig, sorted(rig.cameras))
    for camera, picture in kept.pictures.items():
        (folder / f"{kept.index}-{camera}.jpg").write_bytes(picture.jpeg)
        sample = fiftyone.Sample(filepath=str(folder / f"{kept.index}-{camera}.jpg"), tags=[camera])
        (width, height), found = rig.cameras[camera].size_wh, []
        for row in (row for row in rows if camera in row["seen"]):
            left, top, right, bottom = row["seen"][camera]["rect"]
            place = [(left + 0.5) / width, (top + 0.5) / height, (right - left) / width, (bottom - top) / height]
            found.append(fiftyone.Detection(label=row["label"], confidence=row["score"], bounding_box=place))
        sample["detections"] = fiftyone.Detections(detections=found)
        dataset.add_sample(sample)
