"""Compilation of hot loops by numba: on first use, cached on disk by a digest of their sources.

Only files that hold kernels import this one, because it imports numba.
"""

import hashlib
import os
import pickle
import platform
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import llvmlite.binding
import numba
import numpy as np
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher


def fbench_cache() -> Path:
    """Return the folder of fbench's caches: `$FBENCH_CACHE` where that is set, else in the user's cache. Raises
    RuntimeError where the user has no home folder.
    """
    given = os.environ.get("FBENCH_CACHE", "")
    return Path(given).expanduser().absolute() if given else user_cache() / "fbench"


def user_cache() -> Path:
    """Return the folder in which this user's programs keep caches. Raises RuntimeError where the user has no home
    folder.
    """
    if sys.platform == "win32" and os.environ.get("LOCALAPPDATA"):
        return Path(os.environ["LOCALAPPDATA"])
    given = os.environ.get("XDG_CACHE_HOME", "")
    if Path(given).is_absolute():
        return Path(given)
    return Path.home() / ("Library/Caches" if sys.platform == "darwin" else ".cache")


P = ParamSpec("P")
R = TypeVar("R")

# What reading a damaged pickle raises (pickle's documentation names the first five), and the linker on damaged code.
_DAMAGED = (
    pickle.UnpicklingError, AttributeError, EOFError, ImportError, IndexError,
    KeyError, MemoryError, OSError, RuntimeError, TypeError, ValueError,
)  # fmt: skip


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` on its first call: one thread, IEEE arithmetic, the same result in every process.

    The machine code is kept in a folder of the user's cache named by `kernel_digest`, so that a change to any file
    beside the kernel, to a version or to the CPU starts an empty cache; numba itself only looks at the one file that
    defines the function. A kernel may therefore call kernels of its own folder only. Where the cache can't be
    written, every process compiles anew; what is damaged there is replaced.
    """
    folder = cache_folder(Path(function.__code__.co_filename).parent)
    if folder is None:
        return _compiled(function, cache=False)
    previous = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(folder)  # read by numba while it decorates
    try:
        return _compiled(function, cache=True)
    finally:
        numba.config.CACHE_DIR = previous


def _compiled(function: Callable[P, R], cache: bool) -> Callable[P, R]:
    compiled: Callable[P, R] = numba.njit(fastmath=False, parallel=False, nogil=True, no_cfunc_wrapper=True)(function)
    if cache and isinstance(compiled, Dispatcher):  # with NUMBA_DISABLE_JIT it is the function itself
        compiled._cache = _ForgivingCache(function)  # type: ignore[attr-defined]  # as its `enable_caching` does
    return compiled


class _ForgivingCache(FunctionCache):  # type: ignore[misc]  # numba has no types
    """A cache that at worst doesn't help: files cut short by a crash or a full disk cost a compilation, no run."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except _DAMAGED:
            self._start_anew()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except _DAMAGED:
            self._start_anew()

    def _start_anew(self) -> None:
        """Empty the index, so that the damaged files are overwritten by what is compiled next."""
        try:
            self.flush()
        except OSError:  # full or read-only
            self.disable()


def kernel_digest(sources: Path) -> str:
    """Digest of all Python sources in the folder `sources`, of the versions that compile them, and of the CPU."""
    digest = hashlib.blake2b(digest_size=16)
    versions = (platform.python_version(), numba.__version__, llvmlite.__version__, np.__version__)
    for text in (*versions, llvmlite.binding.get_host_cpu_name()):
        digest.update(f"{text}\0".encode())
    for path in sorted(sources.glob("*.py")):
        content = path.read_bytes()
        digest.update(f"{path.name}\0{len(content)}\0".encode())
        digest.update(content)
    return digest.hexdigest()


def cache_folder(sources: Path) -> Path | None:
    """Return the folder for machine code made from the folder `sources`, or `None` where none can be written."""
    try:
        folder = fbench_cache() / "kernels" / kernel_digest(sources)
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except (OSError, RuntimeError):  # read-only, full, or a user without a home
        return None


VARIABLE = "FBENCH_THREADS"
"""Environment variable that says so; `fbench bench` sets it to 1 in each of its worker processes."""


def num_threads() -> int:
    """As many as `FBENCH_THREADS` says, at least one; without it, one for each processor that this process may use.

    A value that is no number counts as none. Results never depend on it.
    """
    given = os.environ.get(VARIABLE, "").strip()
    if given.isdecimal():
        return max(1, int(given))
    return len(os.sched_getaffinity(0))
