"""Tables of results as a page of Markdown."""

from collections.abc import Iterator

from fbench.replay.data.scores import Figure, Kind, Results, ResultTable, format_number


def markdown(results: Results) -> str:
    """Return the page; figures of the source system stand in brackets behind ours."""
    return "\n".join(_page(results)) + "\n"


def _page(results: Results) -> Iterator[str]:
    yield from (f"# {results.title}", "")
    for name, text in results.facts:
        yield f"- {name}: {f'`{text}`' if name == 'command' else _plain(text)}"
    for table in (*results.tables, *results.measured):
        yield from _table(table)
    if results.problems:
        yield from ("", "## What failed, was left out or missing", "")
        yield from (f"- {_plain(text)}" for text in results.problems)


def _table(table: ResultTable) -> Iterator[str]:
    yield from ("", f"## {table.title}", "")
    heads = ["configuration", *(["space"] if table.has_spaces else []), *(column.name for column in table.columns)]
    yield _row(heads)
    yield _row(["---"] * (2 if table.has_spaces else 1) + ["---:"] * len(table.columns))
    for line in table.lines:
        names = [line.name, line.space] if table.has_spaces else [line.name]
        cells = (_cell(figure, column.kind) for figure, column in zip(line.figures, table.columns, strict=True))
        yield _row([*names, *cells])
    notes = [*table.notes, *(["In brackets: the thesis."] if _has_published(table) else []), *table.reasons]
    yield from ("", *(f"- {_plain(note)}" for note in notes)) if notes else ()


def _cell(figure: Figure, kind: Kind) -> str:
    beside = "" if figure.published is None else f" ({format_number(figure.published, kind)})"
    return format_number(figure.value, kind) + beside


def _has_published(table: ResultTable) -> bool:
    return any(figure.published is not None for line in table.lines for figure in line.figures)


def _row(cells: list[str]) -> str:
    return f"| {' | '.join(map(_plain, cells))} |"


def _plain(text: str) -> str:
    """Keep text from data in its cell and on its line, and from acting as HTML."""
    kept = "".join(c if c.isprintable() else " " for c in text)
    for mark in "\\|[":  # the last begins links, and pictures from anywhere
        kept = kept.replace(mark, f"\\{mark}")
    return kept.replace("<", "&lt;")
