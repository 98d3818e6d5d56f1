"""Which runs count what: numbers of several runs together are of boxes that all of them count."""

from collections.abc import Iterable, Sequence

from fbench.metrics.standard.entries import Heading
from fbench.replay.errors import ConfigError

IN_VIEW = ", in view"


def require_one_matching(matchings: Iterable[tuple[str, str]]) -> None:
    """Refuse to add counts of different boxes: some rigs have cameras, in whose view truth must be, others don't.

    Args:
        matchings: Name of the log, and how boxes match and which of them count in the pipeline's own space.

    Raises:
        ConfigError: naming two that differ.
    """
    found: dict[str, str] = {}
    for log, matching in matchings:
        found.setdefault(matching, log)
    if len(found) < 2:
        return
    (one, first), (other, second) = list(found.items())[:2]
    is_view = one.replace(IN_VIEW, "") == other.replace(IN_VIEW, "")
    advice = "--all-around leaves cameras out" if is_view else "score them apart"
    raise ConfigError(f"runs count different boxes: '{one}' on log '{first}', '{other}' on log '{second}'; {advice}")


def of_some_runs(runs: Sequence[tuple[str, Iterable[Heading]]]) -> list[str]:
    """Say which rows only some of the runs have, as those in images where a rig has no cameras.

    Args:
        runs: Name of the log, and headings of what was measured.
    """
    logs: dict[str, list[str]] = {}
    for log, headings in runs:
        for matching in dict.fromkeys(heading.matching for heading in headings if heading.reason is None):
            logs.setdefault(matching, []).append(log)
    return [
        f"rows by '{matching}' are of {len(held)} of {len(runs)} runs only: {', '.join(held)}"
        for matching, held in logs.items()
        if len(held) < len(runs)
    ]
