"""All of TrackEval 1.3.0's fields: on made-up trackers, and on a real one as its authors published them."""

import csv
import json
from pathlib import Path

import pytest
from tests.metrics.tracking.kitti_text import kitti_sequence, lengths, mot_sequence
from tests.metrics.tracking.oracles.made_tracks import KITTI_NAMES, MOT_NAMES, NUM_FRAMES, kitti_texts, mot_texts
from tests.metrics.tracking.trackeval_fields import compare, expected, table

from fbench.metrics.profiles.choose import evaluate
from fbench.metrics.profiles.trackeval.profiles import TRACKEVAL_KITTI, TRACKEVAL_MOT, TRACKEVAL_MOT15, TRACKEVAL_MOT20

ORACLE = json.loads((Path(__file__).parent / "oracles/trackeval.json").read_text())


def compared(rows, oracle):
    """Compare all that TrackEval has; return what only we have."""
    found = table(rows)
    for name, classes in oracle.items():
        part = "all" if name == "COMBINED_SEQ" else f"sequence {name}"
        for class_, fields in classes.items():
            for key, value in expected(class_, part, fields):
                compare(found, key, value)
    return found


def kitti(name):
    return kitti_sequence(name, *kitti_texts(name), NUM_FRAMES)


def mot(name):
    return mot_sequence(name, *mot_texts(name), NUM_FRAMES)


def test_made_kitti_trackers():
    rest = compared(evaluate(TRACKEVAL_KITTI, map(kitti, KITTI_NAMES)).scores(), ORACLE["kitti"])
    own = {metric for metric, class_, _ in rest if not class_.startswith("cls_comb")}
    assert own == {"mota_no_fp"}


@pytest.mark.parametrize(
    ("profile", "benchmark"), [(TRACKEVAL_MOT, "MOT17"), (TRACKEVAL_MOT20, "MOT20"), (TRACKEVAL_MOT15, "MOT15")]
)
def test_made_mot_trackers(profile, benchmark):
    rest = compared(evaluate(profile, map(mot, MOT_NAMES)).scores(), ORACLE[benchmark])
    assert {metric for metric, *_ in rest} == {"mota_no_fp"}


def test_a_sum_of_sequences_is_bit_equal_in_any_order_and_grouping():
    measured = [TRACKEVAL_KITTI.measure(kitti(name)) for name in KITTI_NAMES]
    a, b, c, d, *others = measured
    one = a + b + c + d + sum(others[1:], others[0])
    assert one == sum(others[1:], others[0]) + ((d + b) + (c + a))
    assert (
        TRACKEVAL_KITTI.scores(one, "all")
        == evaluate(TRACKEVAL_KITTI, map(kitti, KITTI_NAMES)).scores()[: len(TRACKEVAL_KITTI.scores(one, "all"))]
    )


@pytest.mark.slow
def test_a_real_tracker_as_published(shared):
    """`car_detailed.csv` was written by TrackEval beside the tracker's results."""
    root = shared / "data/kitti_tracking"
    if not (root / "trackers_2d/GT-SORT").is_dir():
        pytest.skip(f"no results at {root}/trackers_2d/GT-SORT")
    numbers = lengths(root / "evaluate_tracking.seqmap.training")
    sequences = (
        kitti_sequence(
            name, (root / f"label_02/{name}.txt").read_text(),
            (root / f"trackers_2d/GT-SORT/data/{name}.txt").read_text(), num,
        )
        for name, num in numbers.items()
    )  # fmt: skip
    found = table(evaluate(TRACKEVAL_KITTI, sequences).scores())
    compared_rows = 0
    with (root / "trackers_2d/GT-SORT/car_detailed.csv").open() as file:
        for row in csv.DictReader(file):
            name = row.pop("seq")
            for field, value in row.items():
                compare(found, published(field, "all" if name == "COMBINED" else f"sequence {name}"), float(value))
                compared_rows += 1
    assert compared_rows == 22 * 275


def published(field, part):
    """Key of a column such as `HOTA___5` or `MOTA`."""
    name, _, alpha = field.partition("___")
    metric = name.lower().replace("(0)", "_0")
    if alpha in ("", "AUC"):
        return metric, "car", part
    near = f"{(int(alpha) + 2) // 5 * 0.05:.2f}"
    return metric, "car", f"alpha {near}" if part == "all" else f"{part}, alpha {near}"
