"""Names of files for the logs of sequences, whatever a dataset calls these."""

from collections import Counter
from collections.abc import Mapping, Sequence
from hashlib import blake2b

_MAX_BYTES = 180
"""File systems take 255, and what is being written has a longer name."""


def log_names(names: Sequence[str]) -> Mapping[str, str]:
    """Return the name of each sequence's log, without a suffix.

    Anything but letters, digits and `._-+` becomes `_`. Names that can't be told apart then, also where case doesn't
    count, get a digest of the sequence's name behind them. `names` are all of a dataset, so that a choice among them
    changes nothing.
    """
    plain = {name: _plain(name) for name in names}
    counts = Counter(text.casefold() for text in plain.values())
    return {name: text if counts[text.casefold()] == 1 else _told_apart(text, name) for name, text in plain.items()}


def _plain(name: str) -> str:
    text = "".join(c if c.isalnum() or c in "._-+" else "_" for c in name)
    text = f"_{text[1:]}" if text.startswith(".") or not text else text  # neither hidden nor `..`
    return text if len(text.encode()) <= _MAX_BYTES else _told_apart(text, name)


def _told_apart(text: str, name: str) -> str:
    digest = blake2b(name.encode(errors="surrogatepass"), digest_size=4).hexdigest()
    short = text.encode()[: _MAX_BYTES - 1 - len(digest)].decode(errors="ignore")
    return f"{short}-{digest}"
