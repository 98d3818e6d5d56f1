"""Small runs and suites with known errors, for tests of comparisons and gates."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from tests.metrics.conftest import boxes2d, boxes3d, make_manifest

from fbench.api.scores import score_folder
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Truth
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.runs.digest import START, digest, link
from fbench.replay.runs.folder import FrameRecord, RunWriter

STEP_NS = 100_000_000
NUM_OBJECTS = 4


def places(frame: int) -> list[tuple[float, float]]:
    """Where the objects are: far from each other."""
    return [(10.0 + 8 * n, 3.0 * (n % 2) + 0.01 * frame) for n in range(NUM_OBJECTS)]


def write_drive(
    folder: Path,
    missed: Collection[tuple[int, int]] = (),
    alarms: Collection[int] = (),
    swapped: Collection[int] = (),
    seconds: int = 12,
    missing: Mapping[int, Mapping[str, str]] | None = None,
    has_truth: bool = True,
    every: int = 1,
    in_images: bool = False,
    **changes: Any,
) -> Path:
    """Write and score a run at 10 Hz: (frame, object) of what was missed, frames with a false alarm at (20, -20), and
    frames from which on the first two tracks have each other's id. Only one of `every` frames has truth,
    the others truth in images alone where `in_images` says so.
    """
    chain = START
    with RunWriter(folder) as writer:
        for i in range(10 * seconds):
            kept = [n for n in range(NUM_OBJECTS) if (i, n) not in missed]
            turned = sum(i >= frame for frame in swapped) % 2
            ids = [1 - n if turned and n < 2 else n for n in kept] + ([77] if i in alarms else [])
            spots = [places(i)[n] for n in kept] + ([(20.0, -20.0)] if i in alarms else [])
            found = boxes3d(*spots, label="car", score=[0.9] * len(spots), ids=[float(n) for n in ids])
            found = Boxes3D(**found.arrays(), sources=np.full(len(spots), 3, np.uint8))
            own = digest([i, found])
            chain = link(chain, own)
            gone = (missing or {}).get(i, {})
            stages = {"lidar": digest([kept]), "radar": digest([])}
            record = FrameRecord(i, i * STEP_NS, 0, None, gone, own, chain, stages=stages)
            writer.add_frame(record, {"total": 1_000_000 + i})
            writer.add_boxes("detections", i, found)
            writer.add_boxes("tracks", i, found)
            if has_truth and i % every == 0:
                truth = boxes3d(*places(i), label="car", ids=[float(n) for n in range(NUM_OBJECTS)])
                writer.label_frame(i, Truth(i * STEP_NS, i * STEP_NS, truth, None))
            elif in_images:
                writer.label_frame(i, Truth(i * STEP_NS, i * STEP_NS, None, boxes2d((0, 0, 9, 9), label="car")))
        writer.write_json("faults.json", {"rows": [{"code": "LOG001", "count": 2, "places": []}], "lost": 0})
        writer.write_json("host.json", {"cpu": "x", "cores": 2, "platform": "Linux"})
        writer.finish(make_manifest(digest=chain, num_frames=10 * seconds, **changes))
    score_folder(folder, ScoreOptions())
    return folder


def write_cells(folder: Path, rows: Sequence[Mapping[str, object]]) -> Path:
    """Write the table of a suite."""
    empty = {"log": "log", "pipeline": "lidar3d", "condition": "clear", "rate": "max", "seed": 0, "state": "replayed",
             "reason": "", "key": "k", "run": ""}  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "suite.toml").write_text("version = 1\n", encoding="utf-8")
    pq.write_table(pa.Table.from_pylist([{**empty, **row} for row in rows]), folder / "cells.parquet")
    return folder


def some(share: float, seed: int, seconds: int = 12) -> set[tuple[int, int]]:
    """A random share of all boxes, by frame and object."""
    drawn = np.random.default_rng(seed).random((10 * seconds, NUM_OBJECTS))
    return {(int(i), int(n)) for i, n in np.argwhere(drawn < share)}
