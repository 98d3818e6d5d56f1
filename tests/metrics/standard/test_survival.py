"""Occlusions by hand: whether the id after is the id before."""

import numpy as np
import pytest
from tests.metrics.standard.made import Box, sequence

from fbench.metrics.core.slices import VEHICLE, ScoreKey
from fbench.metrics.tracking.scores import tracking_counts
from fbench.metrics.tracking.survival import SurvivalCounts, survival_rows
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.sequences import Sequence


def made(truth: str, tracks: str, streams: list[int] | None = None, period_s: float = 0.1) -> Sequence:
    """One object, a letter a step.

    Args:
        truth: `o` seen, `h` in truth but hidden, `.` not in truth.
        tracks: The id of the track that is there, `.` for none.
    """
    boxes = [Box(i, 10, id=1, visibility=0.1 if c == "h" else 0.9) for i, c in enumerate(truth) if c != "."]
    found = [Box(i, 10, id=int(c)) for i, c in enumerate(tracks) if c != "."]
    return sequence(boxes, found, len(truth), streams, period_s)


def survival(truth: str, tracks: str, streams: list[int] | None = None) -> tuple[int, int]:
    counts = tracking_counts(made(truth, tracks, streams), VEHICLE, Match("bev", 2.0)).survival
    return sum(counts.occlusions), sum(counts.survived)


@pytest.mark.parametrize(
    ("truth", "tracks", "expected"),
    [
        ("oo..oo", "55..55", (1, 1)),  # kept
        ("oohhoo", "55..55", (1, 1)),  # hidden, though truth has it
        ("oohhoo", "555555", (1, 1)),  # tracked all the way
        ("oohhoo", "556655", (1, 1)),  # what it had meanwhile doesn't matter
        ("oo..oo", "55..66", (1, 0)),  # switched
        ("oo..oo", "55....", (1, 0)),  # lost
        ("oo..oo", "55...5", (1, 1)),  # found again late
        ("oo..oo", "55..65", (1, 0)),  # found again as another first
        ("oo..oo", "5...55", (1, 1)),  # lost before it was hidden
        ("oo..oo", "....55", (0, 0)),  # never tracked before
        ("oo..oo..oo", "55......55", (1, 0)),  # not found again before the next; then not tracked before that
        ("oo..oo..oo", "55..66..66", (2, 1)),
        ("oo..oo..oo", "55..55..55", (2, 2)),
        ("oooooo", "555566", (0, 0)),  # no occlusion, a switch
        ("oo....", "55....", (0, 0)),  # its end is no occlusion
        ("..oooo", "..5555", (0, 0)),
        ("hhoohh", "555555", (0, 0)),
        ("o.o.o.o", "5.5.6.6", (3, 2)),
    ],
)
def test_occlusions_by_hand(truth: str, tracks: str, expected: tuple[int, int]) -> None:
    assert survival(truth, tracks) == expected


def test_streams_are_apart() -> None:
    """Another segment is no occlusion; in two cameras that alternate each has its own."""
    assert survival("oo..oo", "55..55", [0, 0, 0, 1, 1, 1]) == (0, 0)
    # Camera 0 has steps 0, 2, 4 (seen, gone, seen), camera 1 has 1, 3, 5 (seen, seen, seen).
    assert survival("oo.ooo", "55.555", [0, 1] * 3) == (1, 1)
    assert survival("oo.ooo", "55.565", [0, 1] * 3) == (1, 0)
    assert survival("oo.ooo", "55.655", [0, 1] * 3) == (1, 1)
    assert survival("oo.ooo", "55.655", [0] * 6) == (1, 0)


def test_hidden_is_below_a_fifth() -> None:
    for visibility, expected in ((0.19, 1), (0.2, 0), (np.nan, 0)):
        truth = [Box(i, 10, id=1, visibility=visibility if i == 1 else 1.0) for i in range(3)]
        whole = sequence(truth, [Box(i, 10, id=5) for i in range(3)], 3)
        assert sum(tracking_counts(whole, VEHICLE, Match("bev", 2.0)).survival.occlusions) == expected


@pytest.mark.parametrize(("hidden", "which"), [(4, 0), (5, 1), (9, 1), (10, 2), (19, 2), (20, 3), (60, 3)])
def test_lengths_are_times_between_being_seen(hidden: int, which: int) -> None:
    """4 hidden steps of 0.1 s: 0.5 s from seen to seen."""
    whole = made("o" + "." * hidden + "o", "5" + "." * hidden + "5")
    counts = tracking_counts(whole, VEHICLE, Match("bev", 2.0)).survival
    assert [i for i, num in enumerate(counts.occlusions) if num] == [which]


def test_rows() -> None:
    counts = SurvivalCounts((3, 1, 0, 0), (2, 0, 0, 0))
    rows = survival_rows(counts, ScoreKey("vehicle", "all", "bev 2 m"), None)
    assert [(row.slice, row.value) for row in rows] == [
        ("all", 0.5), ("occlusion 0-0.5 s", pytest.approx(2 / 3)), ("occlusion 0.5-1 s", 0.0),
        ("occlusion 1-2 s", None), ("occlusion over 2 s", None),
    ]  # fmt: skip
    assert rows[0].counts == {"occlusions": 4, "survived": 2}
    assert survival_rows(counts + counts, ScoreKey("vehicle", "condition fog", "m"), None)[1].slice.startswith(
        "condition fog, "
    )
    nothing = survival_rows(SurvivalCounts(), ScoreKey("vehicle", "all", "bev 2 m"), None)
    assert [(row.value, row.reason) for row in nothing] == [(None, "no tracked object was occluded")]


def test_frames_without_stamps_tell_no_lengths() -> None:
    """Files that count frames: 100 of them may be 1 s or 50 s."""
    whole = made("oo" + "." * 100 + "oo..oo", "55" + "." * 100 + "55..66", period_s=0.0)
    counts = tracking_counts(whole, VEHICLE, Match("bev", 2.0)).survival
    assert counts == SurvivalCounts(untimed=2, untimed_survived=1)
    first, *others = survival_rows(counts, ScoreKey("vehicle", "all", "bev 2 m"), None)
    assert (first.value, first.counts) == (0.5, {"occlusions": 2, "survived": 1})
    assert {(row.value, row.reason) for row in others} == {(None, "frames have no stamps")}
    timed = SurvivalCounts((3, 1, 0, 0), (2, 0, 0, 0))
    both = survival_rows(timed + counts, ScoreKey("vehicle", "all", "bev 2 m"), None)
    assert (both[0].counts, both[1].counts) == (
        {"occlusions": 6, "survived": 3}, {"occlusions": 3, "survived": 2}
    )  # fmt: skip
