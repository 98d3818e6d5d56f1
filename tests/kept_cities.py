"""Cities that simulations in this process share: building one takes seconds, and most tests only look at its logs."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, lru_cache

import pytest

from fbench.datasets.city import recording
from fbench.datasets.city.recording import Cities
from fbench.datasets.city.world.urban import layout

_layout = lru_cache(4)(layout)
_of = Cities.of


@cache
def kept() -> Cities:
    """The last few, as drives of an experiment share them; `test_city_shared` shows that this changes no log."""
    return Cities()


@contextmanager
def shared_cities() -> Iterator[None]:
    """Let the program, too, take cities from those that are kept."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Cities, "of", lambda _, spec: _of(kept(), spec))
        patch.setattr(recording, "layout", _layout)
        yield
