"""Names of files for the logs of sequences."""

from collections import Counter
from collections.abc import Mapping, Sequence

from fbench.replay.file_names import file_name, told_apart


def log_names(names: Sequence[str]) -> Mapping[str, str]:
    """Return the name of each sequence's log, without a suffix.

    File names that can't be told apart, also where case doesn't count, get a digest of the sequence's name behind them.
    `names` are all of a dataset, so that a choice among them changes nothing.
    """
    plain = {name: file_name(name) for name in names}
    counts = Counter(text.casefold() for text in plain.values())
    return {name: text if counts[text.casefold()] == 1 else told_apart(text, name) for name, text in plain.items()}
