"""All of py-motmetrics 1.4.0's MOTChallenge numbers, on made-up trackers."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.metrics.tracking.kitti_text import mot_objects, mot_sequence
from tests.metrics.tracking.oracles.made_tracks import MOT_NAMES, NUM_FRAMES, mot_texts

from fbench.metrics.profiles.choose import evaluate
from fbench.metrics.profiles.motmetrics import MOTMETRICS
from fbench.metrics.profiles.trackeval.prepare import problems
from fbench.replay.data.sequences import Sequence, Steps

ORACLE = json.loads((Path(__file__).parent / "oracles/motmetrics.json").read_text())
# py-motmetrics multiplies a sequence's undefined MOTP with its 0 matches, so that its overall MOTP is nan where one
# sequence has no match. Ours is the mean over all matches.
NAN_BY_MISTAKE = {("OVERALL", "motp")}


def measured():
    sequences = (mot_sequence(name, *mot_texts(name), NUM_FRAMES) for name in MOT_NAMES)
    return evaluate(MOTMETRICS, sequences)


@pytest.mark.parametrize("name", ORACLE)
def test_made_trackers(name):
    part = "all" if name == "OVERALL" else f"sequence {name}"
    rows = {row.metric: row for row in measured().scores() if row.slice == part}
    assert list(rows) == list(ORACLE[name])
    for metric, value in ORACLE[name].items():
        row = rows[metric]
        if (name, metric) in NAN_BY_MISTAKE:
            assert value is None
            assert 0 < row.value < 0.5
        elif value is None:
            assert row.value is None
            assert "py-motmetrics prints nan" in row.reason
        else:
            assert row.value == pytest.approx(value, abs=1e-9), metric


def test_overall_motp_is_the_mean_over_matches():
    overall = {row.metric: row.value for row in measured().scores() if row.slice == "all"}
    matches, distance = 0, 0.0
    for name in MOT_NAMES:
        of_one = ORACLE[name]
        num = round(of_one["num_misses"] / (1 - of_one["recall"]) * of_one["recall"])
        matches, distance = matches + num, distance + num * (of_one["motp"] or 0)
    assert overall["motp"] == pytest.approx(distance / matches)


def test_pairs_match_where_1_less_the_overlap_is_the_threshold_or_less():
    """1 - 0.49999999999999994 is 0.5 in floats."""
    truth, results = (mot_objects(f"1,1,{left},0,15,40,1,1\n", True) for left in (1.1, 6.1))
    sequence = Sequence("s", Steps.of_one_stream(1), truth, results)
    (own,) = problems(sequence, MOTMETRICS.preparation, MOTMETRICS.match)
    assert own.pairs.values.tolist() == [np.nextafter(0.5, 0)]
    counts = MOTMETRICS.measure(sequence).classes["object"]
    assert (counts.clear.tp, counts.identity.tp) == (1, 1)
