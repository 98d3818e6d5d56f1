"""A draft as the text of an `fbench.toml`, with the reasons as comments."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from fbench.replay.init.draft import Draft, LeftOut, Line, Table, Value

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_ESCAPES = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\r": "\\r", "\t": "\\t"}
_MAX_COMMENT = 300


@dataclass(frozen=True)
class Placed:
    """Where a line of the draft came to stand."""

    number: int
    """Of its line in the file, from 1 on."""
    table: Table
    line: Line


@dataclass(frozen=True)
class Written:
    """The text, and where its lines are."""

    text: str
    places: tuple[Placed, ...]

    @property
    def guesses(self) -> tuple[Placed, ...]:
        """Those that somebody should look at."""
        return tuple(p for p in self.places if p.line.is_guess and p.line.is_active and p.table.is_active)


def write_toml(draft: Draft) -> Written:
    """Return the text; any name, whatever is in it, is read back as it was."""
    rows = [f"# What fbench takes from '{_shown(draft.log)}', written by 'fbench init'; every value can be changed."]
    rows += ["# Times are in ms unless a key says otherwise. Lines with 'guess' deserve a look.", "", "version = 1"]
    places: list[Placed] = []
    for table in draft.tables:
        rows.append("")
        rows += [f"# {_shown(note)}" for note in table.notes]
        rows.append(_header(table))
        for line in table.lines:
            rows.append(_row(line, table.is_active))
            places.append(Placed(len(rows), table, line))
    rows += _left_out(draft.left_out)
    written = Written("", tuple(places))
    rows += list(_closing(written))
    return Written("\n".join(rows) + "\n", written.places)


def toml_key(path: tuple[str, ...]) -> str:
    """Return a dotted key, quoted where it must be."""
    return ".".join(part if _BARE.fullmatch(part) else _quoted(part) for part in path)


def toml_value(value: Value) -> str:
    """Return a value as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, tuple):
        return f"[{', '.join(map(_quoted, value))}]"
    return repr(value)


def plain(text: str) -> str:
    """Return a text that neither ends a line nor steers a terminal."""
    return "".join(c if c.isprintable() else " " for c in text)


def _quoted(text: str) -> str:
    return '"' + "".join(_ESCAPES.get(c) or (c if c.isprintable() else _code(c)) for c in text) + '"'


def _code(character: str) -> str:
    """TOML has no code for half a surrogate pair."""
    number = ord(character)
    if 0xD800 <= number <= 0xDFFF:
        number = 0xFFFD
    return f"\\u{number:04x}" if number < 0x10000 else f"\\U{number:08x}"


def _shown(text: str) -> str:
    """A text in a comment: nothing in it ends the line."""
    short = plain(text)
    return short if len(short) <= _MAX_COMMENT else short[: _MAX_COMMENT - 1] + "…"


def _header(table: Table) -> str:
    row = f"[{toml_key(table.path)}]" + _comment(table.why, table.is_guess)
    return row if table.is_active else f"# {row}"


def _row(line: Line, is_active: bool) -> str:
    row = f"{toml_key((line.key,))} = {toml_value(line.value)}" + _comment(line.why, line.is_guess)
    return row if is_active and line.is_active else f"# {row}"


def _comment(why: str, is_guess: bool) -> str:
    text = f"guess: {why}; check it" if is_guess and why else "guess; check it" if is_guess else why
    return f"  # {_shown(text)}" if text else ""


def _left_out(left_out: tuple[LeftOut, ...]) -> list[str]:
    if not left_out:
        return []
    return ["", "# Left out; to use one after all, give it a table [sensors.NAME] as above:"] + [
        f"#   {_shown(item.topic)}: {_shown(item.why)}" for item in left_out
    ]


def _closing(written: Written) -> Iterator[str]:
    yield ""
    if not written.guesses:
        yield "# Nothing here is a mere guess. 'fbench log preview' shows whether calibration and times are right."
        return
    yield "# Look at these lines, and at the pictures of 'fbench log preview':"
    for place in written.guesses:
        yield f"#   {place.number}: {_shown(toml_key((*place.table.path, place.line.key)))}"
