"""Near names for error messages."""

import difflib
from collections.abc import Iterable


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return `; did you mean 'x'?`, or the known names where none is near."""
    names = sorted(known)
    lower = {n.lower(): n for n in names}
    near = difflib.get_close_matches(name.lower(), list(lower), n=1, cutoff=0.6)
    if not near:
        near = [n for n in sorted(lower) if n.endswith(f".{name.lower()}")][:1]
    if near:
        return f"; did you mean '{lower[near[0]]}'?"
    return f"; there are: {', '.join(names)}" if names else "; there are none"
