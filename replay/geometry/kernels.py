"""Compilation of hot loops by numba: on first use, cached on disk by a digest of what a kernel really calls.

Only files that hold kernels import this one, because it imports numba.
"""

import hashlib
import pickle
import platform
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, NoReturn, ParamSpec, Self, TypeVar

import llvmlite.binding
import numba
import numpy as np
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator
from numba.core.dispatcher import Dispatcher
from numba.core.runtime import rtsys

from fbench.replay.data.files import fbench_cache

P = ParamSpec("P")
R = TypeVar("R")

_OPTIONS = {"fastmath": False, "parallel": False, "nogil": True, "no_cfunc_wrapper": True}
# What reading a damaged pickle raises (pickle's documentation names the first five), and the linker on damaged code.
_DAMAGED = (
    pickle.UnpicklingError, AttributeError, EOFError, ImportError, IndexError,
    KeyError, MemoryError, OSError, RuntimeError, TypeError, ValueError,
)  # fmt: skip


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` on its first call: one thread, IEEE arithmetic, the same result in every process.

    The machine code is kept in fbench's cache under `kernel_digest`, so that a change to the kernel, to a kernel or
    constant that it uses, to a version or to the CPU compiles it anew, and a change elsewhere doesn't. Where the cache
    can't be written, every process compiles; what is damaged there is replaced.
    """
    compiled: Callable[P, R] = numba.njit(**_OPTIONS)(function)
    if isinstance(compiled, Dispatcher):  # with NUMBA_DISABLE_JIT it is the function itself
        compiled._cache = _KernelCache(function)  # type: ignore[attr-defined]  # as its `enable_caching` does
    return compiled


def kernel_part(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` as `kernel` does, but for other kernels alone: what lets Python call it takes long to compile,
    too. Called from Python, it raises TypeError.
    """
    compiled: Callable[P, R] = numba.njit(**_OPTIONS, no_cpython_wrapper=True)(function)
    if isinstance(compiled, Dispatcher):
        compiled._cache = _KernelCache(function)  # type: ignore[attr-defined]

        def refuse(*_: object, **__: object) -> NoReturn:
            raise TypeError(f"{function.__qualname__} is part of a kernel: only kernels can call it")

        # A call from Python looks for machine code among what was inserted, and finding none asks for compilation.
        compiled._insert, compiled._compile_for_args = lambda *_, **__: None, refuse  # type: ignore[attr-defined]
    return compiled


def kernel_digest(function: Callable[..., object]) -> str:
    """Return the digest of a kernel: its bytecode and constants, all kernels and globals that it uses, wherever they
    lie, the versions that compile it, and the CPU.
    """
    digest = hashlib.blake2b(digest_size=16)
    versions = (platform.python_version(), numba.__version__, llvmlite.__version__, np.__version__)
    for text in (*versions, llvmlite.binding.get_host_cpu_name(), repr(_OPTIONS), *_describe_function(function, set())):
        digest.update(f"{text}\0".encode())
    return digest.hexdigest()


def _describe_function(function: Any, known: set[int]) -> Iterator[str]:
    """Yield what decides the machine code of a function, and of all that it calls; each function once."""
    function = function.py_func if isinstance(function, Dispatcher) else function
    if id(function) in known:
        return
    known.add(id(function))
    names = set(_names_in(function.__code__))
    yield from (function.__qualname__, repr(function.__defaults__))
    yield from _describe_code(function.__code__, function.__doc__)
    closure = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    used = {**function.__globals__, **{name: cell.cell_contents for name, cell in closure}}
    for name in sorted(names & used.keys()):
        yield name
        yield from _describe_value(used[name], names, known)


def _describe_value(value: Any, names: set[str], known: set[int]) -> Iterator[str]:
    if isinstance(value, Dispatcher | FunctionType):
        yield from _describe_function(value, known)
    elif isinstance(value, ModuleType):  # of another module of fbench, kernels are attributes
        yield value.__name__
        for name in sorted(names & vars(value).keys()):
            if isinstance(vars(value)[name], Dispatcher):
                yield from _describe_function(vars(value)[name], known)
    elif isinstance(value, np.ndarray):
        yield f"{value.dtype.str}{value.shape}{value.tobytes().hex()}"
    else:
        yield repr(value)


def _describe_code(code: CodeType, doc: str | None = None) -> Iterator[str]:
    yield f"{code.co_code.hex()}{code.co_names}{code.co_varnames}{code.co_freevars}"
    for value in code.co_consts:
        if isinstance(value, CodeType):
            yield from _describe_code(value)
        elif value != doc or doc is None:
            yield repr(sorted(value, key=repr) if isinstance(value, frozenset) else value)


def _names_in(code: CodeType) -> Iterator[str]:
    yield from (*code.co_names, *code.co_freevars)
    for value in code.co_consts:
        if isinstance(value, CodeType):
            yield from _names_in(value)


class _Locator(_CacheLocator):  # type: ignore[misc]  # numba has no types
    """The place of a kernel's machine code, which holds as long as its digest."""

    def __init__(self, function: Callable[..., object], folder: Path) -> None:
        self._digest, self._folder = kernel_digest(function), folder

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Self | None:
        """Return the place, unless none can be written."""
        try:
            locator = cls(py_func, fbench_cache() / "kernels")
            locator.ensure_cache_path()
        except (OSError, RuntimeError):  # read-only, full, or a user without a home
            return None
        return locator

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return self._digest

    def get_disambiguator(self) -> str:
        return self._digest


class _Implementation(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_Locator,)


class _KernelCache(FunctionCache):  # type: ignore[misc]
    """A cache that opens on first use, when all that a kernel calls is there, and that at worst doesn't help: files cut
    short by a crash or a full disk cost a compilation, no run.
    """

    _impl_class = _Implementation

    def __init__(self, function: Callable[..., object]) -> None:
        self._function, self._is_open = function, False

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            if not self._is_open:
                super().__init__(self._function)
                self._is_open = True
            # What a compiler needs it prepares itself. numba's own method does so here, too, though machine code needs
            # only the runtime that allocates arrays: that takes longer than all else, as it imports scipy.
            rtsys.initialize(target_context)
            with self._guard_against_spurious_io_errors():
                return self._load_overload(sig, target_context)
        except _DAMAGED:
            self._start_anew()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            if self._is_open:
                super().save_overload(sig, data)
        except _DAMAGED:
            self._start_anew()

    def _start_anew(self) -> None:
        """Empty the index, so that the damaged files are overwritten by what is compiled next."""
        try:
            if self._is_open:
                self.flush()
        except OSError:  # full or read-only
            self.disable()
