"""Making of plug-ins: pipelines, importers and conditions from their names and settings; closing of pipelines."""

import inspect
import re
import shlex
import signal
import threading
import typing
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, is_dataclass
from itertools import takewhile
from pathlib import Path
from types import FrameType
from typing import Any

from fbench.replay.contracts.conditions import Condition, MakesWeather
from fbench.replay.contracts.entry_points import entry_points_of, load
from fbench.replay.contracts.errors import INTERRUPTS, ConfigError, FbenchError, RunError, one_line
from fbench.replay.contracts.protocols import BoxReader, Closes, Importer, KeepsStderr, Pipeline, TakesArgument, UsesLog
from fbench.replay.contracts.settings import apply_settings, describe
from fbench.replay.contracts.variants import SUFFIX, find_variants, variant_of, variant_settings

_MAX_CHARS = 60


@dataclass(frozen=True)
class PipelineName:
    """Which plug-in, and what follows its name."""

    plugin: str  # `NAME`, `FILE.py:CLASS`, `GROUP/NAME` or `FILE.toml`
    argument: str | None = None
    """Short for the parameter that the plug-in names: `exec:./stack` is `exec` with `command=./stack`."""

    def __str__(self) -> str:
        return self.plugin if self.argument is None else f"{self.plugin}:{self.argument}"

    @property
    def file(self) -> Path | None:
        """The file that holds the class, where it comes from one."""
        path, _, _ = self.plugin.rpartition(".py:")
        return Path(f"{path}.py") if path else None

    @property
    def short(self) -> str:
        """As part of a file name: `mine-Mine` for `dir/mine.py:Mine`, `my_stack` for `exec:./my_stack --fast`."""
        if self.file is not None:
            return _clean(f"{self.file.stem}-{self.plugin.rpartition(':')[2]}")
        if self.argument is None:
            return _clean(self.plugin.replace("/", "-"))
        words = takewhile(lambda word: not word.startswith("-"), self.words)
        if self.plugin == "exec":  # the program's name says more than that it is one
            return _clean("-".join(Path(word).stem for word in words)) or "exec"
        return _clean("-".join([self.plugin, *(_clean(word) for word in words)]))

    @property
    def words(self) -> list[str]:
        """The argument's words, split as a shell does."""
        return _words(self.argument or "")


def parse_name(text: str) -> PipelineName:
    """Take a pipeline's name apart; what isn't known is found out later."""
    head, colon, argument = text.partition(":")
    return PipelineName(head, argument) if colon and re.fullmatch(r"[A-Za-z]\w*", head) else PipelineName(text)


def with_absolute_files(text: str) -> str:
    """A command line, or a single path, as seen from any folder: words that are files here become absolute."""
    words = _words(text)
    # Links stay: a virtual environment's Python is one.
    absolute = [str(Path(word).absolute()) if names_file(word) else word for word in words]
    return text if words == absolute else shlex.join(absolute)


def names_file(word: str) -> bool:
    """Tell whether a word of a command line is the path of a file that is there."""
    # A word such as `fast` may be the name of a file by chance.
    return ("/" in word or "." in word) and not word.startswith("-") and Path(word).is_file()


def _words(text: str) -> list[str]:
    try:
        return shlex.split(text)
    except ValueError:
        return [text]


def _clean(text: str) -> str:
    return re.sub(r"[^\w.-]+", "_", text).strip("_.-")[:_MAX_CHARS]


@contextmanager
def open_pipeline(name: str, settings: list[str]) -> Iterator[tuple[Pipeline, dict[str, object]]]:
    """Build a pipeline as `make_pipeline` does, and close it at the end if it holds something. Raises RunError where it
    can't be closed, unless another error came before.
    """
    pipeline, parameters = make_pipeline(name, settings)
    with close_at_end(pipeline, name):
        yield pipeline, parameters


@contextmanager
def close_at_end(pipeline: Pipeline, name: str) -> Iterator[None]:
    """Close a pipeline at the end of a `with` block as `open_pipeline` does."""
    try:
        yield
    except BaseException:
        with suppress(FbenchError):  # what ended the replay says more
            _close(pipeline, name)
        raise
    _close(pipeline, name)


@contextmanager
def guard(what: str) -> Iterator[None]:
    """Tell whatever a plug-in raises in one line. Raises RunError: `what` failed, and why; errors of
    fbench pass as they are.
    """
    try:
        yield
    except FbenchError:
        raise
    except INTERRUPTS:
        raise
    except BaseException as error:
        raise RunError(f"{what}: {one_line(error)}") from error


def give_log(pipeline: Pipeline, name: str, opened: Callable[[], BoxReader]) -> None:
    """Let a pipeline that needs more of a log than its frames have one of its own. Raises RunError where it fails to
    take it.
    """
    if isinstance(pipeline, UsesLog):
        log = opened()
        with guard(f"pipeline '{name}' can't use the log"):
            pipeline.use_log(log)


def _close(pipeline: Pipeline, name: str) -> None:
    if isinstance(pipeline, Closes):
        is_program = isinstance(pipeline, KeepsStderr)  # which ends in time by itself
        with guard(f"pipeline '{name}' can't be closed"), nullcontext() if is_program else _limit_time(CLOSE_TIMEOUT_S):
            pipeline.close()


CLOSE_TIMEOUT_S = 10.0


@contextmanager
def _limit_time(seconds: float) -> Iterator[None]:
    """Raise TimeoutError in a block that takes longer. Only Python code in the main thread can be interrupted so."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"took longer than {seconds:g} s")

    old = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds, 1.0)  # again each second, for code that goes on all the same
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, old or signal.SIG_DFL)


def make_pipeline(name: str, settings: list[str]) -> tuple[Pipeline, dict[str, object]]:
    """Build a pipeline and return it with its parameters as the manifest shows them. Its name is `NAME`,
    `FILE.py:CLASS`, `NAME:ARGUMENT`, short for the parameter that the class takes from there, or a variant:
    `GROUP/NAME` or `FILE.toml`. Settings, `NAME=VALUE`, are applied after the argument, or after what the variant sets.
    Raises ConfigError for an unknown name or setting, or a class that isn't a pipeline.
    """
    cls, own = _choose_class(name)
    pipeline, params = _make_plugin("pipeline", name, cls, ("start", "reset", "step"), [*own, *settings])
    return pipeline, describe(params)


def _choose_class(name: str) -> tuple[type, list[str]]:
    """The class that a pipeline's name means, and what the name itself sets; untrusted files run no code."""
    cls: type
    variant = variant_of(name)
    if variant is None:
        parsed = parse_name(name)
        cls = load("pipelines", parsed.plugin, others=(found.name for found, _ in find_variants()))
        if parsed.argument is None:
            return cls, []
        if not isinstance(cls, TakesArgument):
            raise ConfigError(f"pipeline '{parsed.plugin}' takes nothing behind a colon, got '{name}'")
        return cls, [f"{cls.argument}={parsed.argument}"]
    base, where = variant.base, f"{variant.where}: 'base'"
    if ".py:" in base:
        raise ConfigError(f"{where}: expected the name of a pipeline, got the file {base}")
    if base.endswith(SUFFIX) or variant_of(base) is not None:
        raise ConfigError(f"{where}: {base} is a variant itself; name a pipeline, and set all")
    try:
        cls = load("pipelines", base)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}", "CFG003") from error
    if isinstance(cls, KeepsStderr):
        raise ConfigError(f"{where}: {base} runs a program; name it on the command line")
    if variant.name in entry_points_of("pipelines"):
        raise ConfigError(f"{variant.where}: 'name': there is a pipeline '{variant.name}'; choose another")
    return cls, variant_settings(variant, default_params(cls))


def pipeline_class(name: str) -> type:
    """Return the class of a pipeline, whose name is written as for `make_pipeline`. Raises ConfigError for an unknown
    name, or a class that can't be imported.
    """
    return _choose_class(name)[0]


def pipeline_parameters(name: str, settings: list[str]) -> dict[str, object]:
    """Return the parameters that `make_pipeline` would give, without making the pipeline. Raises ConfigError for an
    unknown name or setting.
    """
    cls, own = _choose_class(name)
    params = default_params(cls)
    return {} if params is None else describe(apply_settings(params, [*own, *settings]))


def make_importer(name: str, settings: list[str]) -> Importer:
    """Build the importer of a dataset. Raises ConfigError for an unknown name or setting, or a class that isn't an
    importer.
    """
    importer, _ = _make_plugin("dataset", name, load("datasets", name), ("names", "recordings"), settings)
    return importer  # type: ignore[no-any-return]


def make_condition(name: str) -> Condition:
    """Make the condition of an entry point, or that of `FILE.py:CLASS`. Raises ConfigError for an unknown name, or a
    class that isn't a condition.
    """
    cls = load("conditions", name)
    condition, _ = _make_plugin("condition", name, cls, (), [])
    lacking = [field for field in ("version", "kinds", "levels") if field not in dir(condition)]
    if lacking or not (isinstance(condition, MakesWeather) or callable(getattr(condition, "disturb", None))):
        raise ConfigError(f"condition '{name}' isn't one: it lacks {', '.join(lacking) or 'disturb()'}")
    return condition  # type: ignore[no-any-return]


def _make_plugin(what: str, name: str, cls: type, methods: tuple[str, ...], settings: list[str]) -> tuple[Any, Any]:
    absent = [method for method in methods if not callable(getattr(cls, method, None))]
    if absent:
        raise ConfigError(f"{what} '{name}' isn't one: it lacks {', '.join(f'{m}()' for m in absent)}")
    try:
        params = default_params(cls)
        if params is None and settings:
            raise ConfigError(f"{what} '{name}' takes no parameters, so --set {settings[0]} can't be applied")
        params = apply_settings(params, settings)
        return (cls() if params is None else cls(params)), params
    except FbenchError:
        raise
    except INTERRUPTS:
        raise
    except BaseException as error:
        raise ConfigError(f"{what} '{name}' can't be made: {one_line(error)}") from error


def default_params(cls: type) -> Any:
    """Return the defaults of a class's `params`, or `None` where it takes none."""
    if "params" not in inspect.signature(cls).parameters:
        return None
    kind = typing.get_type_hints(cls.__init__).get("params")  # type: ignore[misc]
    if not (isinstance(kind, type) and is_dataclass(kind)):
        raise ConfigError(f"{cls.__name__}: its argument 'params' must be annotated with a dataclass")
    return kind()
