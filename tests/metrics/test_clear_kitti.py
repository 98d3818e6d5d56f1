"""CLEAR against published numbers: a KITTI tracker as scored by TrackEval 1.3.0, every sequence."""

import csv
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from fbench.metrics.clear import ClearCounts, clear_counts
from fbench.metrics.matching import match_hungarian
from fbench.metrics.prepare import Problem
from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.geometry.boxes import iou_2d

THRESHOLD, MIN_HEIGHT_PX = 0.5, 25.0
SEQUENCES = [f"{i:04d}" for i in range(21)]


@dataclass(frozen=True)
class Rows:
    """Boxes of one frame of a KITTI file."""

    number: Int64
    kind: list[str]
    hard: Bool
    """More than half hidden or cut."""
    xyxy: Float64


def read(path: Path) -> dict[int, Rows]:
    frames: dict[int, list[list[str]]] = defaultdict(list)
    for line in path.read_text().splitlines():
        words = line.split()
        frames[int(words[0])].append(words)
    return {frame: parse(rows) for frame, rows in frames.items()}


def parse(rows: list[list[str]]) -> Rows:
    hard = [float(r[3]) > 0 or float(r[4]) > 2 for r in rows]
    numbers = np.array([int(r[1]) for r in rows], np.int64)
    xyxy = np.array([[float(v) for v in r[6:10]] for r in rows]).reshape(-1, 4)
    return Rows(numbers, [r[2].lower() for r in rows], np.array(hard, bool), xyxy)


def covered(boxes: Float64, regions: Float64) -> Bool:
    """Which boxes lie to more than half in one region."""
    low = np.maximum(boxes[:, None, :2], regions[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], regions[None, :, 2:])
    common = np.prod(np.clip(high - low, 0, None), axis=2)
    area = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)
    return np.asarray((common > THRESHOLD * area[:, None]).any(axis=1), bool)


def problem(frame: int, truth: Rows, tracks: Rows) -> Problem:
    """Apply KITTI's rules for cars: what is on vans, hard cars and regions, or small and unmatched, doesn't count."""
    car = np.array([k == "car" for k in truth.kind], bool)
    known = np.array([k in ("car", "van") for k in truth.kind], bool)
    region = np.array([k == "dontcare" for k in truth.kind], bool)
    similarity = iou_2d(truth.xyxy[known], tracks.xyxy)
    partner = match_hungarian(similarity, THRESHOLD).truth_of_estimate
    off = (~car | truth.hard)[known]
    free = partner < 0
    small = tracks.xyxy[:, 3] - tracks.xyxy[:, 1] <= MIN_HEIGHT_PX
    gone = np.where(free, small | covered(tracks.xyxy, truth.xyxy[region]), False)
    gone[~free] = off[partner[~free]]
    count = (car & ~truth.hard)[known]
    used = similarity[count][:, ~gone]
    num = int((~gone).sum())
    return Problem(
        frame=frame, segment=0, stream="", similarity=used, excuse=np.zeros((0, num)), threshold=THRESHOLD,
        shared_excuse=True, score=np.zeros(num), inside=np.ones(num, bool), invalid=np.zeros(num, bool),
        truth_id=truth.number[known][count], estimate_id=tracks.number[~gone], num_bad_truth=0,
    )  # fmt: skip


def problems(root: Path, sequence: str) -> Iterator[Problem]:
    truth = read(root / "label_02" / f"{sequence}.txt")
    tracks = read(root / "trackers_2d/GT-SORT/data" / f"{sequence}.txt")
    for frame in sorted({*truth, *tracks}):
        yield problem(frame, truth.get(frame, parse([])), tracks.get(frame, parse([])))


@pytest.fixture(scope="session")
def published(shared: Path) -> dict[str, dict[str, str]]:
    with (shared / "data/kitti_tracking/trackers_2d/GT-SORT/car_detailed.csv").open() as file:
        return {row["seq"]: row for row in csv.DictReader(file)}


@pytest.fixture(scope="session")
def counted(shared: Path) -> dict[str, ClearCounts]:
    return {s: clear_counts(problems(shared / "data/kitti_tracking", s)) for s in SEQUENCES}


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_counts_of_a_sequence(
    sequence: str, published: dict[str, dict[str, str]], counted: dict[str, ClearCounts]
) -> None:
    found, expected = counted[sequence], published[sequence]
    assert {
        "CLR_TP": found.boxes.tp,
        "CLR_FN": found.boxes.fn,
        "CLR_FP": found.boxes.fp,
        "IDSW": found.idsw,
    } == {name: int(expected[name]) for name in ("CLR_TP", "CLR_FN", "CLR_FP", "IDSW")}
    if found.boxes.tp:
        assert found.similarity_sum / found.boxes.tp == pytest.approx(float(expected["MOTP"]), abs=1e-6)


def test_counts_are_added_over_sequences(published: dict[str, dict[str, str]], counted: dict[str, ClearCounts]) -> None:
    total = sum(counted.values(), ClearCounts())
    boxes = total.boxes
    assert (boxes.fn, boxes.fp, total.idsw) == (1559, 155, 18)
    mota = 1 - (boxes.fn + boxes.fp + total.idsw) / boxes.gt
    assert mota == pytest.approx(float(published["COMBINED"]["MOTA"]), abs=1e-9)
