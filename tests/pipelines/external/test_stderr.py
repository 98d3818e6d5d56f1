"""What is kept of a program's stderr."""

from hypothesis import given
from hypothesis import strategies as st

from fbench.pipelines.external.process import KeptText


@given(st.lists(st.binary(max_size=30)), st.integers(1, 20))
def test_first_and_last_part_are_kept(parts, half):
    text = b"".join(parts)
    kept = KeptText(half)
    for part in parts:
        kept.add(part)
    if len(text) <= 2 * half:
        assert kept.text() == text
    else:
        left_out = f"\n[{len(text) - 2 * half} bytes left out]\n".encode()
        assert kept.text() == text[:half] + left_out + text[-half:]


def test_last_line():
    kept = KeptText(10)
    assert kept.last_line == ""
    kept.add(b"first\nsec")
    assert kept.last_line == "sec"
    kept.add(b"ond\n\n  \n")
    assert kept.last_line == "second"
    kept.begin()
    assert kept.last_line == ""
    kept.add(b"\xff new")
    assert kept.last_line == "\N{REPLACEMENT CHARACTER} new"
    kept.add(b"\n" + b"x" * 1000)
    assert len(kept.last_line) <= 300
