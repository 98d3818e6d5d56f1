"""Progress of commands on stderr, where that is a terminal."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich import progress as bars
from rich.console import Console

from fbench.cli.show import printable
from fbench.replay.runs.secrets import without_secrets


@contextmanager
def message_progress(title: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show how many of `total` messages are done on stderr while the `with` block runs."""
    with _progress(bars.BarColumn(), bars.MofNCompleteColumn(), bars.TimeRemainingColumn()) as progress:
        task = progress.add_task(printable(without_secrets(title)), total=total or None)
        yield lambda num_messages: progress.update(task, completed=num_messages)


@contextmanager
def byte_progress(title: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show how many of `total` bytes are done on stderr while the `with` block runs."""
    with _progress(bars.BarColumn(), bars.DownloadColumn(), bars.TimeRemainingColumn()) as progress:
        task = progress.add_task(printable(without_secrets(title)), total=total)
        yield lambda num_bytes: progress.update(task, completed=num_bytes)


class ImportProgress:
    """Shows the sequence that is being imported, and how many are done."""

    def __init__(self, progress: bars.Progress, num_sequences: int) -> None:
        self._progress = progress
        self._all = progress.add_task("sequences", total=num_sequences, visible=num_sequences > 1)
        self._one = progress.add_task("", total=None, visible=False)

    def __call__(self, name: str, done: int, total: int) -> None:
        """Tell how many items of a sequence are done."""
        self._progress.update(
            self._one, description=printable(without_secrets(name)), completed=done, total=total or None, visible=True
        )

    def done(self) -> None:
        """Tell that a sequence is done."""
        self._progress.advance(self._all)
        self._progress.reset(self._one, visible=False)

    @contextmanager
    def hide(self) -> Iterator[None]:
        """Show nothing while the `with` block runs."""
        self._progress.stop()
        yield
        self._progress.start()

    @contextmanager
    def finish(self, num: int) -> Iterator[None]:
        """Tell that a sequence of `num` items is done; nothing is shown while the `with` block prints about it."""
        # How many there would be was an estimate.
        self._progress.update(self._one, completed=num, total=num or None, refresh=True)
        self._progress.advance(self._all)
        self._progress.stop()
        yield
        self._progress.reset(self._one, visible=False)
        self._progress.start()


@contextmanager
def import_progress(num_sequences: int) -> Iterator[ImportProgress]:
    """Show the progress of an import on stderr while the `with` block runs."""
    with _progress(bars.BarColumn(), bars.MofNCompleteColumn(), bars.TimeRemainingColumn()) as progress:
        yield ImportProgress(progress, num_sequences)


@contextmanager
def frame_progress(title: str) -> Iterator[Callable[[int], None]]:
    """Show a running count of frames on stderr while the `with` block runs."""
    with _progress(bars.TextColumn("{task.completed} frames"), bars.TimeElapsedColumn(), spins=True) as progress:
        task = progress.add_task(printable(without_secrets(title)), total=None)
        yield lambda num_frames: progress.update(task, completed=num_frames)


@contextmanager
def replay_progress(title: str) -> Iterator[Callable[[int, int], None]]:
    """Show how many replays are done, of how many, on stderr while the `with` block runs."""
    with _progress(bars.BarColumn(), bars.MofNCompleteColumn(), bars.TimeElapsedColumn(), spins=True) as progress:
        task = progress.add_task(printable(without_secrets(title)), total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


def _progress(*columns: bars.ProgressColumn, spins: bool = False) -> bars.Progress:
    """On stderr, where that is a terminal, and gone when it ends; spins where nobody knows how much there is."""
    console = Console(file=sys.stderr)  # this one, whatever plug-ins get in its place
    named = [*([bars.SpinnerColumn()] if spins else []), bars.TextColumn("{task.description}", markup=False)]
    return bars.Progress(*named, *columns, console=console, transient=True, disable=not console.is_terminal)
