"""`fbench verify --relations`: which relations hold, and the exit code."""

import pytest

_PIPELINES = """
from dataclasses import dataclass
import numpy as np
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Output

class Honest:
    def start(self, rig, log_info): pass
    def reset(self, reason): pass
    def centers(self, frame):
        return frame.messages["radar"].xyz[:1] + [2.0, 0.5, 0.0]
    def step(self, frame):
        c = np.array([self.centers(frame)[0] + [0, dy, 0] for dy in (0.0, 9.0, -9.0)], float)
        boxes = Boxes3D(c, np.ones((3, 3)), np.zeros(3), label=np.array(["car"] * 3), track_id=np.arange(3))
        return Output(self.seen(boxes, frame), boxes, {})
    def seen(self, boxes, frame): return boxes

class RightOnly(Honest):
    def seen(self, boxes, frame): return boxes[boxes.center_m[:, 1] < 3.0]

class Blind(Honest):
    def step(self, frame):
        found = super().step(frame)
        return Output(found.detections[:0], found.tracks[:0], {})

class Early(Honest):
    def seen(self, boxes, frame):
        if frame.stamp_ns > 10**12:
            raise RuntimeError("that late?")
        return boxes
"""


@pytest.fixture
def verify(fbench, log, tmp_path):
    (tmp_path / "mine.py").write_text(_PIPELINES)
    return lambda name, *words: fbench("verify", log, "-p", f"mine.py:{name}", "--relations", *words)


def _states(result):
    return {row["relation"]: row["violated"] for row in result.json()["relations"]}


def test_an_honest_pipeline_holds(verify, tmp_path):
    result = verify("Honest", "--keep", "kept")
    assert result.code == 0
    assert "no relation is violated" in result.out
    assert "world: the log has no poses" in result.out
    assert {path.name for path in (tmp_path / "kept").iterdir()} == {
        "original", "clock", "twice", "mirror", "thinned", "relations.json",
    }  # fmt: skip


def test_a_pipeline_that_sees_one_side_only_violates_the_mirror(verify):
    result = verify("RightOnly", "--json")
    assert result.code == 1
    assert [name for name, violated in _states(result).items() if violated] == ["mirror"]
    text = verify("RightOnly").out
    assert "VIOLATED: 1 of 5 relations" in text


def test_two_checks_compare_by_relation_and_the_broken_one_comes_first(verify, fbench, tmp_path):
    for name, folder in (("Honest", "base"), ("Honest", "again"), ("RightOnly", "head")):
        verify(name, "--keep", folder)
    words = ("--reference", "base", "--json")
    found = fbench("compare", "base", "head", *words)
    assert (found.code, found.err) == (1, "")
    rows = found.json()["rows"]
    assert rows[0]["slice"] == "relation mirror"
    assert (rows[0]["base"], rows[0]["verdict"]) == (1.0, "REGRESSED")
    assert rows[0]["head"] == pytest.approx(0.5)  # of two boxes on the right in each, one is the same
    assert {row["verdict"] for row in rows[1:5]} <= {"same", "changed", "new"}
    assert found.json()["headline"].startswith("REGRESSED: mine-Honest -> mine-RightOnly: agreement, any, relation")
    same = fbench("compare", "base", "again", *words)
    assert (same.code, same.json()["state"]) == (0, "identical")
    text = fbench("compare", "head", "base", "--reference", "base").out
    assert "relation mirror" in text
    (tmp_path / "head/relations.json").write_text('{"format": 2}')
    broken = fbench("compare", "base", "head")
    assert (broken.code, broken.err.count("\n")) == (3, 1)
    assert "relations.json: not a file of this version" in broken.err


def test_what_says_nothing_has_a_reason(verify):
    result = verify("Blind")
    assert result.code == 0
    assert "mirror: neither run has a box" in result.out


def test_a_pipeline_that_fails_violates(verify):
    result = verify("Early", "--json")
    assert (result.code, _states(result)["clock"]) == (1, True)
    row = next(row for row in result.json()["relations"] if row["relation"] == "clock")
    assert "that late?" in row["reason"]


@pytest.mark.parametrize(("words", "said"), [(("--quick",), "--quick"), (("--repeat", "3"), "--repeat")])
def test_options_of_repeated_replays_are_refused(verify, words, said):
    result = verify("Early", *words)
    assert (result.code, result.err) == (2, f"fbench: --relations doesn't repeat: leave out {said}\n")
