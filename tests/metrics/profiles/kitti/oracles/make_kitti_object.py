"""Write what OpenPCDet's KITTI object evaluation says about made-up frames: `kitti_object.json` beside this file.

How to run, in an environment of its own:

    pip install numpy==2.4.6 numba shapely==2.2.0
    python make_kitti_object.py OPENPCDET_REPOSITORY

OPENPCDET_REPOSITORY is a clone of https://github.com/open-mmlab/OpenPCDet that has commit 8cacccec. Its `eval.py` is
imported as it is; the CUDA kernel beside it, which works in single precision, is replaced by shapely in double.
"""

import importlib
import json
import subprocess
import sys
import tempfile
import types
from pathlib import Path
from typing import Any

import numpy as np
import shapely  # type: ignore[import-untyped]

COMMIT = "8cacccec11db6f59bf6934600c9a175dae254806"
SOURCE = "pcdet/datasets/kitti/kitti_object_eval_python/eval.py"
HERE = Path(__file__).parent
CASES = {"sparse": (0, 80, 12.0), "crowded": (1, 60, 3.0)}
"""Seed, frames and crowding of `made_frames`."""
STRICT = [[0.7, 0.5, 0.5]] * 3
LOOSE = [[0.7, 0.5, 0.5], [0.5, 0.25, 0.25], [0.5, 0.25, 0.25]]


def overlaps(boxes: np.ndarray, others: np.ndarray, criterion: int = -1) -> np.ndarray:
    """Overlap (N, M) of turned rectangles (N, 5), x, z, length, width, rotation_y; criterion 2: the area alone."""
    polygons = [np.array([shapely.Polygon(footprint(b)) for b in side]) for side in (boxes, others)]
    if not len(boxes) or not len(others):
        return np.zeros((len(boxes), len(others)))
    common = shapely.area(shapely.intersection(polygons[0][:, None], polygons[1][None, :]))
    if criterion == 2:
        return common
    assert criterion == -1
    areas = [side[:, 2] * side[:, 3] for side in (boxes, others)]
    return common / (areas[0][:, None] + areas[1][None, :] - common)


def footprint(box: np.ndarray) -> np.ndarray:
    """Corners (4, 2): x right, z forward, turned about y, which points down."""
    x, z, length, width, turn = box
    along, across = np.array([1, 1, -1, -1]) * length / 2, np.array([1, -1, -1, 1]) * width / 2
    cos, sin = np.cos(turn), np.sin(turn)
    return np.column_stack([x + cos * along + sin * across, z - sin * along + cos * across])


def loaded(repository: str, folder: Path) -> Any:
    """Import `eval.py` with the kernel replaced."""
    package = folder / "kitti_eval"
    package.mkdir()
    text = subprocess.run(["git", "-C", repository, "show", f"{COMMIT}:{SOURCE}"], check=True, capture_output=True)
    (package / "eval.py").write_bytes(text.stdout)
    (package / "__init__.py").write_text("")
    kernel: Any = types.ModuleType("kitti_eval.rotate_iou")
    kernel.rotate_iou_gpu_eval = overlaps
    sys.modules["kitti_eval.rotate_iou"] = kernel
    sys.path.insert(0, str(folder))
    return importlib.import_module("kitti_eval.eval")


def annotations(rows: Any) -> dict[str, np.ndarray]:
    """One frame as the script reads label files."""
    names = ("name", "truncated", "occluded", "alpha", "bbox", "location", "rotation_y", "score")
    return {name: getattr(rows, name) for name in names} | {"dimensions": rows.lhw}


def main() -> None:
    """Evaluate and write: 4 kinds x 3 classes x 3 difficulties x (strict, loose), over 11 and over 40 recalls."""
    sys.path.insert(0, str(HERE))
    made_frames = importlib.import_module("kitti_objects_input").made_frames
    with tempfile.TemporaryDirectory() as name:
        script = loaded(sys.argv[1], Path(name))
        report = {}
        for case, arguments in CASES.items():
            frames = made_frames(*arguments)
            truth, results = ([annotations(frame[side]) for frame in frames] for side in (0, 1))
            found = script.do_eval(truth, results, [0, 1, 2], np.array([STRICT, LOOSE]), True)
            names = ("bbox", "bev", "3d", "aos", "bbox_R40", "bev_R40", "3d_R40", "aos_R40")
            report[case] = {key: values.tolist() for key, values in zip(names, found, strict=True)}
        (HERE / "kitti_object.json").write_text(json.dumps(report, indent=0) + "\n")


if __name__ == "__main__":
    main()
