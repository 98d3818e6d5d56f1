"""Commands that write, each run in a child of this process, which has imported all that they need.

A child runs by itself or as process 1 of a namespace of processes, as in a container, where each process has the same
number as the one before it.
"""

import ctypes
import os
import shutil
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path

from tests.cli import conftest as logs
from tests.cli.test_demo import small
from tests.datasets.kitti.conftest import write_tracking
from tests.kept_cities import shared_cities

from fbench.api.suites.run import run_suite
from fbench.api.suites.runner import RunOptions
from fbench.cli import demo, main
from fbench.replay.contracts.errors import EXIT_DATA, FbenchError
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import NO_CONFIG, LogRequest

_MEASURED = {"timings.parquet", "latency.json", "host.json", "cell.json", "latency.md", "report.html"}
_NEWPID = 0x20000000  # CLONE_NEWPID of <sched.h>
_LIBC = ctypes.CDLL(None, use_errno=True)


@dataclass(frozen=True)
class Command:
    """One command. It writes `out` in the folder that it is called in, and reads what is in `in` beside it."""

    call: Callable[[], int | None]
    out: str
    has_parts: bool = False  # Whether each part of it is there as soon as it is finished
    replaces: bool = True  # Whether it makes anew what is there, or goes on from it

    def digest(self, folder: Path) -> Mapping[str, str]:
        """Digests of what it wrote, measured times left out, by name."""
        found, target = {}, folder / self.out
        files = sorted(p for p in target.rglob("*") if p.is_file()) if target.is_dir() else [target]
        files = [p for p in files if not any(part.startswith(".") for part in p.relative_to(folder).parts)]  # drafts
        for path in files:
            if path.exists() and (path == target or path.name not in _MEASURED):
                found[str(path.relative_to(folder))] = blake2b(path.read_bytes(), digest_size=8).hexdigest()
        return found


def _fbench(*args: str) -> Callable[[], None]:
    def call() -> None:
        sys.argv = ["fbench", *args]
        main()

    return call


def _demo() -> None:
    demo.make_experiment = lambda *_: small(Path("out"), "lidar3d", conditions=("clear",))  # in this process alone
    _fbench("demo", "-o", "out", "--jobs", "1")()


def _bench() -> int:
    cells = [
        ReplayRequest(LogRequest(Path("../in/a.mcap"), config=NO_CONFIG), name, out=Path("out") / name, overwrite=True)
        for name in ("lidar3d", "radar3d")
    ]
    try:
        return max(0 if result.has_run else 3 for result in run_suite(cells, RunOptions(1)))
    except (FbenchError, OSError) as error:  # a function, which has no command
        sys.stderr.write(f"fbench: {error}\n")
        return getattr(error, "exit_code", EXIT_DATA)


COMMANDS: Mapping[str, Command] = {
    "replay": Command(
        _fbench("replay", "../in/a.mcap", "-p", "lidar3d", "--all-around", "-o", "out", "--overwrite"), "out"
    ),
    "convert": Command(_fbench("log", "convert", "../in/a.mcap", "-o", "out.parquet", "--overwrite"), "out.parquet"),
    "import": Command(_fbench("log", "import", "kitti", "../in/kitti", "-o", "out", "--overwrite"), "out", True),
    "report": Command(_fbench("report", "../in/run", "-o", "out.html"), "out.html"),
    "demo": Command(_demo, "out", True, replaces=False),
    "bench": Command(_bench, "out", True, replaces=False),
}


def prepare(folder: Path) -> None:
    """Make what the commands read."""
    source = folder / "in"
    source.mkdir()
    logs.write_log(source / "a.mcap", [*logs.messages(20), *logs.truths(20)])
    write_tracking(source / "kitti")
    (folder / "first").mkdir()
    code = run(COMMANDS["replay"], folder / "first").wait()
    assert code == 0, (folder / "first.stderr").read_text()
    shutil.move(folder / "first" / "out", source / "run")


@dataclass
class Child:
    """A command that runs."""

    number: int  # Of the process that waits for the command
    command: int  # Of the command's process, as this one sees it

    def wait(self) -> int:
        """Wait for its end, and return its exit code; negative: the number of the signal that ended it."""
        return os.waitstatus_to_exitcode(os.waitpid(self.number, 0)[1])

    def ends_within(self, seconds: float) -> bool:
        """Tell whether it ended before so many seconds were over."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if os.waitid(os.P_PID, self.number, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None:
                return True
            time.sleep(0.002)
        return False


def can_contain() -> bool:
    """Tell whether this process may make a namespace of processes."""
    number = os.fork()
    if number == 0:
        os._exit(0 if _LIBC.unshare(_NEWPID) == 0 else 1)
    return os.waitpid(number, 0)[1] == 0


def run(
    command: Command, folder: Path, is_contained: bool = False, before: Callable[[], object] | None = None
) -> Child:
    """Start a command in a folder, where it leaves its output in `stdout` and `stderr`; `before` is called in its
    process.
    """
    reader, writer = os.pipe()
    waiting = os.fork()
    if waiting == 0:
        os.close(reader)
        os.setsid()
        if is_contained and _LIBC.unshare(_NEWPID):
            os._exit(99)
        number = os.fork()
        if number == 0:
            os.close(writer)
            os._exit(_call(command, folder, before))
        os.write(writer, str(number).encode())
        os.close(writer)
        status = os.waitstatus_to_exitcode(os.waitpid(number, 0)[1])
        os._exit(status if status >= 0 else 128 - status)
    os.close(writer)
    number = int(os.read(reader, 20) or b"0")
    os.close(reader)
    return Child(waiting, number)


def _call(command: Command, folder: Path, before: Callable[[], object] | None) -> int:
    os.chdir(folder)
    for name, number in (("stdout", 1), ("stderr", 2)):
        os.dup2(os.open(folder.parent / f"{folder.name}.{name}", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
    try:
        if before is not None:
            before()
        with shared_cities():
            return int(command.call() or 0)
    except SystemExit as stop:
        return int(stop.code or 0)
    except BaseException:  # noqa: BLE001 (a child must never go on as if it were its parent)
        import traceback

        traceback.print_exc()
        return 70
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
