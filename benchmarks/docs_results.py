"""Print the tables of docs/results.md from a suite: `python benchmarks/docs_results.py runs/suite/results.json`.

Rows of further files, in which some configurations were measured again, replace those of the files before.
"""

import json
import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from fbench.metrics.experiment import ORDER, PUBLISHED
from fbench.replay.data.scores import DASH, Figure, Kind, format_figure, format_number

Rows = Mapping[tuple[str, str, str], Mapping[str, Any]]
"""Figures by configuration, space and column."""
WRITTEN = "thesis/"


def row(*cells: str) -> str:
    """Return a line of a table."""
    return f"| {' | '.join(cells)} |"


def head(*names: str, left: int) -> Iterator[str]:
    """Yield the first two lines of a table, whose first columns are texts."""
    yield row(*names)
    yield row(*["---"] * left, *["---:"] * (len(names) - left))


def show(figures: Rows, key: tuple[str, str, str], kind: Kind, *, with_thesis: bool = False) -> str:
    """A figure with its interval, and where asked for with that of the thesis."""
    found = figures.get(key)
    if found is None:
        return DASH
    text = format_figure(Figure(found["value"], low=found.get("low"), high=found.get("high")), kind)
    return f"{text}; thesis {format_number(found['published'], kind)}" if with_thesis and found["published"] else text


def own_space(name: str) -> str:
    """In which a configuration's boxes are: its name says so."""
    return "image" if "2d" in name else "3D"


def place(line: tuple[str, str]) -> tuple[int, int]:
    """Where the line of a configuration, or of one over another, and its space stands."""
    name = line[0].partition(" over ")[0]
    return ("image", "3D").index(line[1]), ORDER.index(name) if name in ORDER else len(ORDER)


def accuracy(figures: Rows) -> Iterator[str]:
    """Yield table 9.4, the configurations as written beside fbench's."""
    yield from head(
        "configuration", "scored", "F1", "MOTA", "MOTA w/o FP", "as written: F1", "as written: MOTA w/o FP",
        "the thesis: F1", "the thesis: MOTA", left=2,
    )  # fmt: skip
    known = {name for name, _, _ in figures}
    for name in (name for name in ORDER if not name.startswith(WRITTEN) and {name, WRITTEN + name} & known):
        space, published = own_space(name), PUBLISHED.get((name, own_space(name)))
        yield row(
            f"`{name}`", space,
            *(show(figures, (name, space, column), "share") for column in ("F1", "MOTA", "MOTA w/o FP")),
            *(show(figures, (WRITTEN + name, space, column), "share") for column in ("F1", "MOTA w/o FP")),
            *(format_number(None if published is None else value, "share")
              for value in ((published.f1, published.mota_no_fp) if published else (None, None))),
        )  # fmt: skip


def by_column(figures: Rows, kind: Kind, *, written: bool | None = None) -> Iterator[str]:
    """Yield a table with a column for each condition: of fbench's configurations, those as written, or all lines."""
    columns = list(dict.fromkeys(column for _, _, column in figures))
    yield from head("configuration", "scored", *columns, left=2)
    for name, space in sorted(dict.fromkeys((name, space) for name, space, _ in figures), key=place):
        if written is None or (space == own_space(name) and name.startswith(WRITTEN) == written):
            cells = (show(figures, (name, space, c), kind, with_thesis=written is False) for c in columns)
            yield row(f"`{name}`", space, *cells)


def main(paths: Sequence[Path]) -> Iterator[str]:
    """Yield all tables, each twice where the suites have it for road and sidewalk alone."""
    tables = defaultdict[str, dict[tuple[str, str, str], Mapping[str, Any]]](dict)
    for path in paths:
        for name, rows in json.loads(path.read_text())["tables"].items():
            tables[name] |= {(row["name"], row["space"], row["column"]): row for row in rows}
    for part in ("", "_region"):
        if f"accuracy{part}" not in tables:
            continue
        yield from ("", f"## {'Road and sidewalk only' if part else 'Everything'}", "")
        yield from accuracy(tables[f"accuracy{part}"])
        for written in (False, True):
            yield from ("", *by_column(tables[f"robustness{part}"], "change", written=written))
        yield from ("", *by_column(tables[f"gain{part}"], "change"))
        yield from ("", *by_column(tables[f"f1_by_condition{part}"], "share", written=False))
    if "disturbances" in tables:
        yield from ("", "## Other disturbances")
        for written in (False, True):
            yield from ("", *by_column(tables["disturbances"], "change", written=written))


if __name__ == "__main__":
    print("\n".join(main([Path(path) for path in sys.argv[1:]])))
