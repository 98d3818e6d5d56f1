"""Which frames of a log are replayed, as options say it."""

import pytest

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.engine.excerpt import Excerpt, Moment, make_excerpt


@pytest.mark.parametrize(
    ("options", "expected", "text"),
    [
        ((None, None, None), Excerpt(), "all"),
        ((None, None, "30:40"), Excerpt(30, 40), "frames 30:40"),
        ((None, None, "7"), Excerpt(7, 8), "frames 7:8"),
        ((None, None, "7:"), Excerpt(7), "frames 7:"),
        ((None, None, ":7"), Excerpt(0, 7), "frames 0:7"),
        (("1.5", None, None), Excerpt(start=Moment(1_500_000_000, since_start=True)), "from +1500000000ns"),
        (
            ("0", "5ns", None),
            Excerpt(start=Moment(0, since_start=True), end=Moment(5, since_start=False)),
            "from +0ns to 5ns",
        ),
    ],
)
def test_options_are_understood(options, expected, text):
    excerpt = make_excerpt(*options)
    assert excerpt == expected
    assert str(excerpt) == text
    assert excerpt.is_whole == (text == "all")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ((None, None, "5:5"), "--frames 5:5: the range is empty"),
        ((None, None, "a:b"), "--frames a:b: expected A:B, A:, :B or one index"),
        ((None, None, ":"), "expected A:B"),
        ((None, None, "-3:4"), "expected A:B"),
        ((None, None, "٣:٤"), "expected A:B"),
        (("soon", None, None), "--from soon: expected seconds from the start on, such as 12.5, or a stamp"),
        (("-1", None, None), "--from -1: expected seconds"),
        ((None, "nan", None), "--to nan: expected seconds"),
        ((None, "1e30", None), "--to 1e30: expected seconds"),
        (("2", "2", None), "--from 2 --to 2: the range is empty"),
    ],
)
def test_bad_options_are_usage_errors(options, message):
    with pytest.raises(ConfigError, match=message):
        make_excerpt(*options)


def test_ranges_are_half_open():
    excerpt = Excerpt(2, 4, Moment(10, since_start=True), Moment(60, since_start=False))
    assert [i for i in range(6) if excerpt.has(i, 55, 40)] == [2, 3]
    assert [s for s in (49, 50, 59, 60) if excerpt.has(2, s, 40)] == [50, 59]
