"""How figures are shown."""

import pytest

from fbench.replay.data.scores import Column, Figure, Line, ResultTable, format_count, format_number, table_rows


@pytest.mark.parametrize(
    ("value", "kind", "text"),
    [
        (0.6824, "share", "68.2"), (-0.1237, "change", "-12.4"), (0.11111, "change", "+11.1"), (0.0, "change", "0.0"),
        (-0.00001, "change", "0.0"), (-0.00001, "share", "0.0"), (20, "count", "20"), (1.2345, "ms", "1.23"),
        (None, "share", "–"),
    ],
)  # fmt: skip
def test_shown(value, kind, text):
    assert format_number(value, kind) == text


@pytest.mark.parametrize(
    ("num", "plural", "text"),
    [(0, "boxes", "0 boxes"), (1, "boxes", "1 box"), (2, "boxes", "2 boxes"), (1, "", "1 box")],
)
def test_counts_agree_with_their_noun(num, plural, text):
    assert format_count(num, "box", plural) == text
    assert format_count(num, "box", plural, is_estimate=True) == f"≈{text}"


TABLE = ResultTable(
    "t", "T", (Column("a"), Column("b")),
    (Line("x", "image", (Figure(1.0), Figure(None, "why"))), Line("y", "", (Figure(None, "why"), Figure(0.0)))),
)  # fmt: skip


def test_reasons_are_told_once():
    assert TABLE.reasons == ("b of x image, a of y: why",)


def test_rows():
    assert len(table_rows(TABLE)) == 4
    assert table_rows(TABLE)[1] == {
        "name": "x", "space": "image", "column": "b", "value": None, "reason": "why", "published": None, "counts": {},
    }  # fmt: skip
