"""Guard of importers, which are plug-ins: whatever one raises becomes one line."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from fbench.replay.contracts.errors import RunError
from fbench.replay.contracts.importing import Imported, ImportRequest
from fbench.replay.contracts.plugins import guard
from fbench.replay.contracts.protocols import Importer, Recording
from fbench.replay.data.files import file_name, with_digest
from fbench.replay.data.rig import LogInfo, Rig

T = TypeVar("T")


class GuardedImporter:
    """An importer of which errors say that it was `dataset`'s; see `Importer`."""

    def __init__(self, importer: Importer, dataset: str) -> None:
        self._importer, self._dataset = importer, dataset

    def names(self, source: Path) -> Sequence[str]:
        """Names of the sequences, each once. Raises RunError where it fails, or gives something else."""
        what = f"dataset '{self._dataset}' can't name the sequences in {source}"
        with guard(what):
            names = list(self._importer.names(source))
        for name in names:
            if not isinstance(name, str):
                raise RunError(f"{what}: {type(name).__name__} isn't a name")
        if twice := sorted(name for name, num in Counter(names).items() if num > 1):
            raise RunError(f"{what}: '{twice[0]}' is there twice")
        return names

    def recordings(self, source: Path, request: ImportRequest) -> Iterator[Recording]:
        """Open the sequences. Raises RunError where it fails."""
        what = f"dataset '{self._dataset}' can't open a sequence in {source}"
        with guard(what):
            recordings = iter(self._importer.recordings(source, request))
        for recording in _steps(what, recordings):
            with guard(what):
                name = recording.name
            yield _GuardedRecording(recording, name, f"dataset '{self._dataset}' can't import '{name}'")


class _GuardedRecording:
    """See `Recording`."""

    def __init__(self, recording: Recording, name: str, what: str) -> None:
        self.name = name
        self._recording, self._what = recording, what

    @property
    def info(self) -> LogInfo:
        with guard(self._what):
            return self._recording.info

    @property
    def rig(self) -> Rig:
        with guard(self._what):
            return self._recording.rig

    @property
    def num_items(self) -> int:
        with guard(self._what):
            return int(self._recording.num_items)

    def items(self) -> Iterator[Imported]:
        with guard(self._what):
            items: Iterable[Imported] = iter(self._recording.items())
        yield from _steps(self._what, items)

    def summary(self) -> Sequence[str]:
        with guard(self._what):
            return [str(line) for line in self._recording.summary()]


def _steps(what: str, items: Iterable[T]) -> Iterator[T]:
    """Guard the steps of a generator, and not what is done between them."""
    steps = iter(items)
    while True:
        with guard(what):
            try:
                item = next(steps)
            except StopIteration:
                return
        yield item


def log_names(names: Sequence[str]) -> Mapping[str, str]:
    """Return the name of each sequence's log, without a suffix.

    File names that can't be told apart, also where case doesn't count, get a digest of the sequence's name behind them.
    `names` are all of a dataset, so that a choice among them changes nothing.
    """
    plain = {name: file_name(name) for name in names}
    counts = Counter(text.casefold() for text in plain.values())
    return {name: text if counts[text.casefold()] == 1 else with_digest(text, name) for name, text in plain.items()}
