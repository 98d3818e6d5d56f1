from hypothesis import given
from hypothesis import strategies as st

from fbench.datasets.importing.guard import log_names


def test_names_are_kept_where_they_can_be():
    assert log_names(["scene-0001", "2011_09_26", "Straße+1.2"]) == {
        "scene-0001": "scene-0001", "2011_09_26": "2011_09_26", "Straße+1.2": "Straße+1.2",
    }  # fmt: skip


def test_names_that_would_collide_are_told_apart():
    files = log_names(["a/b", "a_b", "A_B", "c/d"])
    assert files["c/d"] == "c_d"
    assert files["a_b"].startswith("a_b-")
    assert len({text.casefold() for text in files.values()}) == 4


def test_no_name_is_hidden_or_leads_elsewhere():
    assert list(log_names(["", "..", ".x.mcap.partial-1", "../../etc"]).values())[1:] == [
        "_.", "_x.mcap.partial-1", "_._.._etc"
    ]  # fmt: skip
    assert log_names([""])[""] == "_"
    assert log_names(["\x1b[31mred\n"])["\x1b[31mred\n"] == "__31mred_"


@given(st.lists(st.text(max_size=300), unique=True, max_size=6))
def test_every_list_gives_usable_names_that_differ(names):
    files = log_names(names)
    assert list(files) == names
    assert len({text.casefold() for text in files.values()}) == len(names)
    for text in files.values():
        assert text
        assert "/" not in text
        assert text.isprintable()
        assert not text.startswith(".")
        assert len(text.encode()) <= 180
