"""Which sequence of the truth belongs to which of the results."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from fbench.metrics.files.lengths import read_seqmap
from fbench.metrics.files.sources import Source
from fbench.replay.errors import ConfigError, MetricError
from fbench.replay.names import did_you_mean

Missing = Literal["error", "empty"]
MISSING: tuple[Missing, ...] = get_args(Missing)
_NAMED = 5


@dataclass(frozen=True)
class Choice:
    """What of the files is scored."""

    sequences: tuple[str, ...] = ()
    """Empty: all of the truth."""
    seqmap: Path | None = None
    """A list of sequences with their lengths; others aren't scored."""
    missing: Missing = "error"
    """What a sequence without results is."""


@dataclass(frozen=True)
class Pair:
    """One sequence in both."""

    name: str
    truth: str
    """As the truth calls it."""
    estimates: str | None
    """As the results call it; `None`: there are none."""
    num_frames: int | None
    """As the seqmap says."""


@dataclass(frozen=True)
class Pairing:
    """All that is scored, and what there is to say about the rest."""

    pairs: tuple[Pair, ...]
    notes: tuple[str, ...]


def paired(truth: Source, estimates: Source, choice: Choice) -> Pairing:
    """Match sequences by their names; two files that are one sequence each belong together whatever their names are.

    Raises:
        ConfigError: where an unknown sequence is asked for.
        MetricError: where no sequence has truth (GT001), or one has no results and that is no miss.
    """
    lengths = {} if choice.seqmap is None else read_seqmap(choice.seqmap)
    if truth.is_single and estimates.is_single and not lengths:
        name = truth.names[0]
        _require_known(choice.sequences, (name,))
        return Pairing((Pair(name, name, estimates.names[0], None),), ())
    everything = tuple(lengths) or tuple(dict.fromkeys([*truth.names, *estimates.names]))
    _require_known(choice.sequences, everything)
    wanted = [name for name in everything if not choice.sequences or name in choice.sequences]
    scored = [name for name in wanted if name in truth.names]
    without = [name for name in wanted if name not in truth.names]
    if not scored:
        raise MetricError(f"{truth.path}: no truth for any sequence of {_who(estimates, lengths)}", "GT001")
    notes = [f"no truth for {_listed(without)}: left out [GT001]"] if without else []
    absent = [name for name in scored if name not in estimates.names]
    if absent and choice.missing == "error":
        raise MetricError(
            f"{estimates.path}: no results for {_listed(absent)}; add an empty file, or count them as misses with "
            "--missing empty"
        )
    notes += [f"no results for {_listed(absent)}: all of its truth is missed"] if absent else []
    pairs = [Pair(n, n, n if n in estimates.names else None, lengths.get(n)) for n in scored]
    return Pairing(tuple(pairs), tuple(notes))


def _who(estimates: Source, lengths: dict[str, int | None]) -> str:
    return "the seqmap" if lengths else str(estimates.path)


def _require_known(wanted: tuple[str, ...], known: tuple[str, ...]) -> None:
    for name in wanted:
        if name not in known:
            raise ConfigError(f"--sequences {name}: no such sequence{did_you_mean(name, known)}")


def _listed(names: list[str]) -> str:
    shown = ", ".join(names[:_NAMED])
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{'sequence' if len(names) == 1 else f'{len(names)} sequences:'} {shown}{more}"
