"""The commands of `fbench`, and how their errors become one line and an exit code."""

import errno
import gc
import io
import os
import resource
import signal
import sys
import threading
from contextlib import suppress
from functools import cache
from importlib import import_module
from types import FrameType
from typing import Annotated, Any

import typer
from typer import Option
from typer.main import get_command

from fbench.cli.options import examples
from fbench.cli.show import printable, show_traceback
from fbench.replay.contracts.errors import EXIT_DATA, EXIT_USAGE, INTERRUPTS, FbenchError, TerminatedError, one_line
from fbench.replay.runs.secrets import without_secrets

_COMMANDS = (
    "demo", "init", "replay", "score", "report", "view", "compare", "robust", "sweep", "profile", "verify", "plugins",
)  # fmt: skip
_GROUPS = ("bench", "log", "baseline", "weights")
_OF_LOGS = ("info", "check", "preview", "convert", "import", "export", "simulate")

_MIN_ADDRESS_BYTES = 2 << 30
_OBJECTS_UNTIL_COLLECTION = 10_000

_INTERRUPTED = 128 + signal.SIGINT  # Typer's exit code for KeyboardInterrupt

# Typer shows the class of all usage errors only as the parent of another.
_UsageError: type[typer.BadParameter] = typer.BadParameter.__bases__[0]


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(version("fbench"))
        raise typer.Exit


def _common_options(
    debug: Annotated[bool, Option("--debug", help="Show tracebacks of errors.")] = False,
    version: Annotated[
        bool, Option("--version", callback=_show_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Replay recorded sensor logs into perception pipelines, and measure them."""
    del debug, version  # commands find the first in their context


def make_app(*names: str) -> typer.Typer:
    """Return the commands and groups of these names: others needn't be imported, nor their options made."""
    app = typer.Typer(
        name="fbench",
        help="Replay recorded sensor logs into perception pipelines, and measure them.",
        pretty_exceptions_enable=False,
        add_completion=False,
        rich_markup_mode="rich",
    )
    app.callback()(_common_options)
    for name in names:
        if name == "log":
            log = typer.Typer(help="Inspect, check, convert, import, export, and simulate logs.", no_args_is_help=True)
            for own in _OF_LOGS:
                function = "import_" if own == "import" else own
                log.command(own, epilog=examples(f"log {own}"))(_load(f"log_{own}", function))
            app.add_typer(log, name=name)
        elif name in _GROUPS:
            app.add_typer(_load(name, "app"), name=name)
        else:
            app.command(name, epilog=examples(name))(_load(name, name))
    return app


def _load(module: str, name: str) -> Any:
    return getattr(import_module(f"fbench.cli.{module}"), name)


def main() -> None:
    """Run the command line; foreseen errors become one line on stderr and an exit code."""
    # One BLAS thread, so that sums never depend on the number of cores; must be set before numpy is imported.
    os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
    # Arrow's own allocator keeps what it once had, and tens of megabytes add up.
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")
    # What is wrong with an image is told in one line, by who reads it.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    # Imports make a hundred thousand objects that stay; looking among them for cycles time and again takes long.
    gc.set_threshold(_OBJECTS_UNTIL_COLLECTION)
    _open_standard_files()
    # So that a cancelled job cleans up behind itself.
    signal.signal(signal.SIGTERM, _terminate)
    sys.unraisablehook = _raise_again
    interrupts = list[int]()  # Ctrl-C, told from what a plug-in raises
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:

        def interrupt(number: int, frame: FrameType | None) -> None:
            interrupts.append(number)
            raise KeyboardInterrupt

        signal.signal(signal.SIGINT, interrupt)
    arguments = sys.argv[1:]
    debug = "--debug" in arguments
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < _MIN_ADDRESS_BYTES:
        # Below it numerical libraries crash or hang instead of failing.
        least = f"at least {_MIN_ADDRESS_BYTES >> 10} are needed, of which most is never used"
        _complain(f"out of memory: ulimit -v allows {limit >> 10} KiB of addresses, {least}")
        sys.exit(EXIT_USAGE)
    try:
        # It may stand anywhere, as people add it to the end of a command that went wrong.
        others = [a for a in arguments if a != "--debug"] or ["--help"]
        first = next((a for a in others if not a.startswith("-")), "")
        all_names = () if others[0] == "--version" else (*_COMMANDS, *_GROUPS)
        names = (first,) if first in (*_COMMANDS, *_GROUPS) else all_names
        code = _command(names)(["--debug", *others] if debug else others, standalone_mode=False)
        if code == _INTERRUPTED and not interrupts:
            raise typer.Abort
        sys.exit(code)
    except typer.Abort:
        _complain("a plug-in ended the command with KeyboardInterrupt or EOFError; --debug shows where")
        sys.exit(EXIT_DATA)
    except TerminatedError:
        sys.exit(128 + signal.SIGTERM)
    except Exception as error:  # noqa: BLE001 - a mistake of fbench, or of a plug-in where none is expected
        if debug:
            show_traceback(error)
        if line := _line(error):  # empty where help was shown instead
            _complain(line)
        code = EXIT_USAGE if isinstance(error, _UsageError) else EXIT_DATA
        sys.exit(error.exit_code if isinstance(error, FbenchError) else code)


@cache
def _command(names: tuple[str, ...]) -> Any:
    """These commands, built anew by no further call of `main` in this process."""
    return get_command(make_app(*names))


_AGAIN_S = 0.1


def _open_standard_files() -> None:
    """Open what is closed of stdin, stdout and stderr, or else files of a run would get their numbers and whatever a
    library prints; let each take any text.
    """
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # of any locale: what it can't show mustn't end a command
            stream.reconfigure(errors="backslashreplace")


def _complain(line: str) -> None:
    """Write a line to stderr, if that is there and has room: the exit code counts all the same."""
    with suppress(OSError, ValueError, AttributeError):
        sys.stderr.write(f"fbench: {line}\n")
        sys.stderr.flush()


def _raise_again(lost: "sys.UnraisableHookArgs") -> None:
    """Send a signal again that came where Python drops exceptions, such as in the callback of a library."""
    if isinstance(lost.exc_value, INTERRUPTS):
        number = signal.SIGTERM if isinstance(lost.exc_value, TerminatedError) else signal.SIGINT
        threading.Timer(_AGAIN_S, os.kill, (os.getpid(), number)).start()
    else:
        sys.__unraisablehook__(lost)


def _terminate(number: int, frame: FrameType | None) -> None:
    raise TerminatedError


_SIGNS_OF_NO_MEMORY = ("failed to map segment", "Cannot allocate memory", "bad_alloc")
_SIGNS_OF_NO_PROCESS = ("can't start new thread", os.strerror(errno.EAGAIN))


def _line(error: Exception) -> str:
    """One line about an error, whatever is in its text."""
    match error:
        case FbenchError():
            text = error.line
        case MemoryError():
            text = "out of memory: the data needs more than there is"
        case ImportError() | OSError() | RuntimeError() if any(sign in str(error) for sign in _SIGNS_OF_NO_MEMORY):
            text = f"out of memory: {one_line(error)}"
        case OSError() | RuntimeError() if any(sign in str(error) for sign in _SIGNS_OF_NO_PROCESS):
            text = f"out of processes, threads or memory (ulimit -u, ulimit -v): {one_line(error)}"
        case OSError() if error.errno is not None:
            text = f"{error.filename or 'output'}: {os.strerror(error.errno)}"
        case _UsageError():
            text = error.format_message()
        case _:
            text = f"a mistake in fbench or a plug-in: {one_line(error)}; --debug shows where"
    return printable(without_secrets(text))
