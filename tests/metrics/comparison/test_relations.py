"""Relations that were kept of two versions of a pipeline, compared by hand-written files."""

import json
from pathlib import Path

import pytest

from fbench.metrics.comparison.relations import RELATIONS_FILE, compare_relations
from fbench.replay.contracts.errors import RunError


def kept(folder: Path, **agreements: float | None) -> Path:
    folder.mkdir()
    rows = [
        {"relation": name, "least": 0.9, "agreement": value, "violated": value is not None and value < 0.9,
         "reason": "" if value is not None else "the log has no poses"}
        for name, value in agreements.items()
    ]  # fmt: skip
    (folder / RELATIONS_FILE).write_text(json.dumps({"format": 1, "relations": rows}))
    return folder


def test_each_relation_is_judged_and_the_largest_fall_comes_first(tmp_path: Path) -> None:
    base = kept(tmp_path / "a", clock=1.0, mirror=0.95, thinned=0.5, twice=0.99, world=0.97, fresh=None)
    head = kept(tmp_path / "b", clock=1.0, mirror=0.4, thinned=0.95, twice=0.7, world=None, fresh=0.95)
    rows = compare_relations(base, head, "mine", "")
    assert [(row.slice.removeprefix("relation "), row.verdict, row.reason) for row in rows] == [
        ("mirror", "REGRESSED", "it doesn't hold any more"),
        ("twice", "REGRESSED", "it doesn't hold any more"),
        ("world", "REGRESSED", "nothing was measured: the log has no poses"),
        ("clock", "same", "it holds"),
        ("fresh", "new", "only head tried it"),
        ("thinned", "improved", "it holds now"),
    ]
    assert rows[0].delta == pytest.approx(0.4 - 0.95)


def test_a_relation_that_head_does_not_have_is_not_forgotten(tmp_path: Path) -> None:
    rows = compare_relations(kept(tmp_path / "a", clock=1.0, world=1.0), kept(tmp_path / "b", clock=1.0), "mine", "")
    assert [(row.slice, row.verdict, row.head) for row in rows] == [
        ("relation world", "REGRESSED", None), ("relation clock", "same", 1.0),
    ]  # fmt: skip


@pytest.mark.parametrize("text", ["", "[]", '{"format": 2, "relations": []}', '{"format": 1}'])
def test_what_is_no_such_file_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    base = kept(tmp_path / "a", clock=1.0)
    head = kept(tmp_path / "b", clock=1.0)
    (head / RELATIONS_FILE).write_text(text)
    with pytest.raises(RunError, match=r"relations\.json: not a file of this version of fbench") as caught:
        compare_relations(base, head, "mine", "")
    assert "\n" not in str(caught.value)
