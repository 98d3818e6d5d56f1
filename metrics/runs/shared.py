"""What several metrics of one run need, made once."""

from collections.abc import Callable, Hashable
from functools import cached_property
from typing import TypeVar, cast

from fbench.replay.store import Run

T = TypeVar("T")


class SharedRun(Run):
    """A run that keeps what is derived of it for as long as it lives; metrics that don't know of it see a run."""

    @cached_property
    def kept(self) -> dict[Hashable, object]:
        """By what it is and all that it depends on."""
        return {}


def once(run: Run, key: Hashable, make: Callable[[], T]) -> T:
    """Return what `make` returns; of a shared run it is called for the first time only."""
    if not isinstance(run, SharedRun):
        return make()
    if key not in run.kept:
        run.kept[key] = make()
    return cast(T, run.kept[key])
