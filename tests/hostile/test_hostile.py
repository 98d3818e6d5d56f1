"""Untrusted input of all kinds: read as it was, counted, flagged or refused in one line, within bounds.

The findings of all earlier runs and a few new cases of each kind in every test run, more in the slow ones; `make fuzz`
goes on for as long as one likes.
"""

from collections import Counter

import pytest
from tests.hostile import run, whole
from tests.hostile.minimize import CORPUS, reduce, signature
from tests.hostile.target import FINDINGS, OUTCOMES, Case, Found, Target, unpack
from tests.hostile.targets import TARGETS
from tests.hostile.worker import worker

QUICK = ("json", "toml", "rig", "boxes", "box-table", "mcap-unchunked", "mcap-forged")
"""Kinds of which a case takes some milliseconds."""
OTHERS = ("mcap", "parquet", "bag1", "cdr", "exec")


def findings(arguments, total):
    said = list(run.judge(arguments, total))
    assert sum(number >= 0 for _, number, _, _ in said) == total, said[-1:]
    assert {outcome for _, _, outcome, _ in said} <= {*OUTCOMES, *FINDINGS}
    return [line for line in said if line[2] in FINDINGS]


def test_what_was_found_is_mended():
    files = sorted(map(str, CORPUS.iterdir()))
    assert len(files) > 3
    assert findings(files, len(files)) == []


def test_a_few_cases_of_each_kind():
    assert findings([0, 60, *QUICK], 60 * len(QUICK)) == []
    assert findings([0, 6, *OTHERS], 6 * len(OTHERS)) == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", TARGETS)
def test_many_cases(kind):
    num = 30 if kind in whole.TARGETS else 150  # whole commands take up to a second
    assert findings([0, num, kind], num) == []


def test_a_case_is_made_of_its_number_alone():
    with worker("mcap-forged", TARGETS["mcap-forged"]) as one, worker("mcap-forged", TARGETS["mcap-forged"]) as other:
        for number in (7, 3):
            assert one.case(number) == other.case(number)
        assert one.case(3) != one.case(7)


def lossy(_):
    raise AssertionError


ENDS = {
    "silent": lambda folder: Found(content=Counter({(folder / "a").read_text(): 1})),
    "error": lambda folder: 1 / 0,
    "memory": lambda folder: len(bytearray(600 * 2**20)),
}


@pytest.mark.parametrize("outcome", ENDS)
def test_the_harness_finds(outcome):
    """The oracle itself: wrong data without a word, errors of Python, memory."""
    target = Target("", lossy, ENDS[outcome])
    with worker("toml", target) as one:
        assert one.judge(Case({"a": b"12"}, {"a": b"13"} if outcome == "silent" else None))[0] == outcome


def test_a_finding_is_reduced_while_it_stays_one():
    small = reduce(Case({"a": b"some words and then X, and more words"}), lambda case: b"X" in case.files["a"])
    assert small.files == {"a": b"X"}
    undone = reduce(Case({"a": b"1234567X"}, {"a": b"abcdefgh"}), lambda case: b"X" in case.files["a"])
    assert undone.files == {"a": b"abcdefgX"}
    assert signature("error", "KeyError in a.py:f: 'x'") == signature("error", "KeyError in a.py:f: 'y'")


def test_cases_of_the_corpus_are_files(tmp_path):
    case = Case({"log/a": b"1", "b": b"2"}, {"b": b"3"})
    (tmp_path / "a").write_bytes(case.pack("rig"))
    assert unpack(tmp_path / "a") == ("rig", case)
    assert case.pack("rig") == case.pack("rig")


def test_the_table_of_the_page_is_that_of_the_tally():
    text = run.PAGE.read_text()
    assert run.page(text, run.read_counts(run.TALLY), run.read_counts(run.INTERRUPTS)) == text
