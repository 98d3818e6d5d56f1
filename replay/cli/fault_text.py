"""How faults of the data are told to people."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from fbench.replay.errors import LogError
from fbench.replay.faults import FAULTS, FaultLog


@contextmanager
def explained(faults: FaultLog) -> Iterator[None]:
    """Add what was lost before it to the message of a log that can't be used: the first such fault of the table."""
    try:
        yield
    except LogError as error:
        lost = [(code, places) for code, places in sorted(faults.places.items()) if FAULTS[code].behaviour == "count"]
        first = next((f"{FAULTS[code].text}: {places[0]}" for code, places in lost), None)
        if first is None:
            raise
        raise LogError(f"{error}; before that: {first}", error.code) from error


def fault_lines(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """One line a kind of fault that was met, from the rows of a `FaultLog`."""
    return [f"fault: {_line(row)}" for row in rows if row["count"]]


def _line(row: Mapping[str, Any]) -> str:
    first = f" (first: {row['places'][0]})" if row["places"] else ""
    return f"{row['code']} {row['text']}: {row['count']}{first}"
