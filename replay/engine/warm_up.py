"""Notice of code that is compiled, or loaded as it was compiled before, while a pipeline runs."""

import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

_NUMBA_EVENTS = "numba.core.event"
_KIND = "numba:compiler_lock"  # Held whenever a kernel meets new types: to compile it, or to load it from a cache


class WarmUp:
    """Counts how often numba compiled or loaded a kernel, in any thread; free where numba isn't imported."""

    def __init__(self) -> None:
        self._num, self._is_listening, self._stack = 0, False, ExitStack()

    def count(self) -> int:
        """Return how often so far. That numba itself was imported since the last call counts as once."""
        if not self._is_listening and _NUMBA_EVENTS in sys.modules:
            self._is_listening = True
            self._num += 1
            self._stack.enter_context(_listen(self._add))
        return self._num

    def close(self) -> None:
        """Listen no more."""
        self._stack.close()

    def _add(self) -> None:
        self._num += 1


@contextmanager
def _listen(notify: Any) -> Iterator[None]:
    from numba.core import event  # is imported already

    class Listener(event.Listener):  # type: ignore[misc]  # numba has no types
        def on_start(self, event: Any) -> None:
            notify()

        def on_end(self, event: Any) -> None:
            pass

    listener = Listener()
    event.register(_KIND, listener)
    try:
        yield
    finally:
        event.unregister(_KIND, listener)
