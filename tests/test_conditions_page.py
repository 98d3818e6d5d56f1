"""The catalog in `docs/conditions.md` is that of the entry points; run as a program, this file writes it."""

import inspect
from pathlib import Path

from fbench.replay.conditions.spec import load_condition
from fbench.replay.contracts.conditions import needs_of
from fbench.replay.contracts.entry_points import entry_points_of

PAGE = Path(__file__).resolve().parents[1] / "docs" / "conditions.md"
BEGIN, END = "<!-- catalog, written by `python tests/test_conditions_page.py` -->\n", "<!-- end -->\n"


def row(name: str) -> str:
    condition = load_condition(name)
    first = " ".join((inspect.getdoc(type(condition)) or "").split("\n\n")[0].split()).replace("|", "\\|")
    levels = "; ".join(f"`{key}` {', '.join(f'{v:g}' for v in values)}" for key, values in condition.levels.items())
    needs = ", ".join(needs_of(condition)) or "–"
    return f"| `{name}` | {', '.join(condition.kinds)} | {first} | {levels} | {needs} |"


def catalog() -> str:
    """Conditions of this package alone: others may be installed beside it."""
    points = entry_points_of("conditions").items()
    names = [name for name, point in points if point.value.startswith("fbench.")]
    head = "| condition | sensors | what happens | levels | needs |\n|---|---|---|---|---|\n"
    return head + "".join(f"{row(name)}\n" for name in names)


def split() -> tuple[str, str, str]:
    before, _, rest = PAGE.read_text().partition(BEGIN)
    inside, _, after = rest.partition(END)
    return before, inside, after


def test_the_catalog_is_that_of_the_entry_points():
    assert split()[1] == catalog()


if __name__ == "__main__":
    start, _, end = split()
    PAGE.write_text(start + BEGIN + catalog() + END + end)
