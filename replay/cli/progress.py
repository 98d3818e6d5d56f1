"""Progress on a terminal; nothing elsewhere."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from fbench.replay.secrets import without_secrets


@contextmanager
def message_progress(title: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show how many of `total` messages are done on stderr while the `with` block runs."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(without_secrets(title), total=total or None)
        yield lambda num_messages: progress.update(task, completed=num_messages)


@contextmanager
def frame_progress(title: str) -> Iterator[Callable[[int], None]]:
    """Show a running count of frames on stderr while the `with` block runs."""
    console = Console(stderr=True)
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        TextColumn("{task.completed} frames"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(without_secrets(title), total=None)
        yield lambda num_frames: progress.update(task, completed=num_frames)


@contextmanager
def replay_progress(title: str) -> Iterator[Callable[[int, int], None]]:
    """Show how many replays are done, of how many, on stderr while the `with` block runs."""
    console = Console(stderr=True)
    done = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    columns = (SpinnerColumn(), TextColumn("{task.description}"), *done)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(without_secrets(title), total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)
