"""Tables of results as a page of Markdown."""

from collections.abc import Iterator, Sequence

from fbench.replay.data.scores import Figure, Kind, Results, ResultTable, format_figure, format_number


def markdown(results: Results) -> str:
    """Return the page without what was measured; figures of the source system stand in brackets behind ours."""
    lines = [f"# {results.title}", ""]
    lines += [f"- {name}: {f'`{text}`' if name == 'command' else plain_text(text)}" for name, text in results.facts]
    lines += _tables(results.tables)
    if results.problems:
        lines += ["", "## What failed, was left out or missing", "", *(f"- {plain_text(p)}" for p in results.problems)]
    return "\n".join(lines) + "\n"


def markdown_of_times(results: Results) -> str:
    """Return the page of what was measured, which differs from run to run."""
    return "\n".join([f"# {results.title}: times", *_tables(results.measured)]) + "\n"


def _tables(tables: Sequence[ResultTable]) -> list[str]:
    return [line for table in tables for line in ("", *_table(table))]


def _table(table: ResultTable) -> Iterator[str]:
    def row(*cells: str) -> str:
        return f"| {' | '.join(map(plain_text, cells))} |"

    def show(figure: Figure, kind: Kind) -> str:
        beside = "" if figure.published is None else f" ({format_number(figure.published, kind)})"
        return format_figure(figure, kind) + beside

    yield from (f"## {table.title}", "")
    yield row("configuration", *(["space"] * table.has_spaces), *(column.name for column in table.columns))
    yield row(*["---"] * (1 + table.has_spaces), *["---:"] * len(table.columns))
    for line in table.lines:
        cells = (show(figure, column.kind) for figure, column in zip(line.figures, table.columns, strict=True))
        yield row(line.name, *([line.space] * table.has_spaces), *cells)
    has_published = any(figure.published is not None for line in table.lines for figure in line.figures)
    notes = [*table.notes, *(["In brackets: the thesis."] * has_published), *table.reasons]
    yield from ("", *(f"- {plain_text(note)}" for note in notes)) if notes else ()


def plain_text(text: str) -> str:
    """Keep text from data in its cell and on its line, and from acting as HTML."""
    kept = "".join(c if c.isprintable() else " " for c in text)
    for mark in "\\|[":  # the last begins links, and pictures from anywhere
        kept = kept.replace(mark, f"\\{mark}")
    return kept.replace("<", "&lt;")
