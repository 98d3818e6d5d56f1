"""One running program: bytes in and out under a deadline, and a sure end."""

import fcntl
import os
import select
import shlex
import shutil
import signal
import subprocess
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from fbench.replay.contracts.errors import ConfigError, FbenchError
from fbench.replay.contracts.plugins import names_file

_OWN_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""fbench sets these for itself: another program has threads of its own."""
_MARK = "FBENCH_EXEC"  # The environment has it of a program and of all that it starts, whatever their group


@dataclass(frozen=True)
class Command:
    """A program and its arguments."""

    program: str  # Absolute path
    words: Sequence[str]  # As they were written, the program first
    title: str = ""
    is_own: bool = False  # Whether it is one of fbench's, which keeps to as many threads as fbench itself

    @property
    def name(self) -> str:
        """What it is called in messages: its title, else the program's file name."""
        return self.title or Path(self.program).name

    @property
    def files(self) -> list[Path]:
        """The program, and the files that its arguments name: scripts, weights."""
        return [Path(self.program), *(Path(word) for word in self.words[1:] if names_file(word))]


def parse_command(text: str) -> Command:
    """Split a command line as a shell does, without running one, and find the program in PATH or as a path. Raises
    ConfigError where there is no such program, or it can't be executed.
    """
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise ConfigError(f"exec: command {text!r} can't be split into words: {error}") from error
    if not words or not words[0] or "\0" in text:
        raise ConfigError("exec: needs a command, such as -p 'exec:./my_stack --option'")
    word = words[0]
    path = Path(word if "/" in word else shutil.which(word) or word).absolute()
    if path.is_dir() or not path.exists():
        where = "no such program" if "/" in word else "no such program in PATH or in this folder"
        raise ConfigError(f"exec: {word}: {where}")
    if not os.access(path, os.X_OK):
        raise ConfigError(f"exec: {word}: isn't executable; try chmod +x {word}")
    return Command(str(path), words)


_HALF_BYTES = 512 * 1024
_LINE_CHARS = 300
_LINE_BYTES = 4096


class KeptText:
    """Keeps the first and the last part of what is added, and counts what lies between them."""

    def __init__(self, half_bytes: int = _HALF_BYTES) -> None:
        self._half = half_bytes
        self._first, self._last = bytearray(), bytearray()
        self._num = self._mark = 0

    def add(self, data: bytes) -> None:
        """Add what was read."""
        self._num += len(data)
        room = self._half - len(self._first)
        self._first += data[:room]
        self._last += data[room:]
        if len(self._last) > 2 * self._half:
            del self._last[: -self._half]

    def begin(self) -> None:
        """Let `last_line` look only at what comes from here on."""
        self._mark = self._num

    @property
    def last_line(self) -> str:
        """The last line since `begin` that isn't empty, cut to 300 characters; empty where there is none."""
        num = min(self._num - self._mark, _LINE_BYTES)
        tail = (bytes(self._first[-num:]) + bytes(self._last[-num:]))[-num:] if num else b""
        lines = [line.strip() for line in tail.decode(errors="replace").splitlines()]
        return next((line for line in reversed(lines) if line), "")[:_LINE_CHARS]

    def text(self) -> bytes:
        """All that is kept."""
        last = bytes(self._last[-self._half :])
        left_out = self._num - len(self._first) - len(last)
        gap = f"\n[{left_out} bytes left out]\n".encode() if left_out else b""
        return bytes(self._first) + gap + last


_PIPE_BYTES = 1 << 20
_READ_BYTES = 1 << 16
_READS_AT_ONCE = 16
_MAX_PIECES = 512  # Buffers a write, below the system's limit
_LAST_WORDS_S = 0.5  # How long a program that closed a pipe has to exit, so that the reason can be told


class ProgramError(FbenchError):
    """A program crashed, hung, or doesn't keep to the protocol."""


class Deadline:
    """So much time for one exchange."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._end_s = time.monotonic() + seconds

    @property
    def left_s(self) -> float:
        """Time left [s], negative when it is over."""
        return self._end_s - time.monotonic()


class Process:
    """A program with pipes for stdin, stdout and stderr, in a session of its own.

    One loop watches all of them and the process itself: nothing that the program does, or fails to do, blocks. At most
    `max_unread` bytes may wait on its stdout for somebody who wants them. Raises ConfigError where the program can't be
    executed.
    """

    def __init__(self, command: Command, stderr: KeptText, max_unread: int) -> None:
        pipe, self._mark = subprocess.PIPE, f"{os.getpid()}-{time.monotonic_ns()}"
        left_out = () if command.is_own else _OWN_VARIABLES
        environment = {k: v for k, v in os.environ.items() if k not in left_out} | {_MARK: self._mark}
        try:
            self._popen = subprocess.Popen(  # noqa: S603 - the user names the program, and no shell is involved
                command.words, executable=command.program, stdin=pipe, stdout=pipe, stderr=pipe, bufsize=0,
                start_new_session=True, env=environment,
            )  # fmt: skip
        except OSError as error:
            raise ConfigError(f"exec: {command.words[0]}: can't be executed ({error.strerror})") from error
        self._files = [f for f in (self._popen.stdin, self._popen.stdout, self._popen.stderr) if f is not None]
        self._stdin, self._stdout, self._stderr = (file.fileno() for file in self._files)
        self._exit = os.pidfd_open(self._popen.pid)
        for fd in (self._stdin, self._stdout, self._stderr):
            os.set_blocking(fd, False)
        with suppress(OSError):  # a small pipe works as well, more slowly
            fcntl.fcntl(self._stdin, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
        self._kept, self._max_unread = stderr, max_unread
        self._poll = select.poll()
        for fd in (self._stdout, self._stderr, self._exit):
            self._poll.register(fd, select.POLLIN)
        self._received = bytearray()
        self._ended = False

    def send(self, pieces: list[bytes | memoryview], deadline: Deadline) -> None:
        """Write all pieces to the program's stdin. Raises ProgramError where it ends, closes its stdin, or hasn't read
        them by the deadline.
        """
        left = total = sum(map(len, pieces))
        first = 0
        self._poll.register(self._stdin, select.POLLOUT)
        try:
            while left:
                try:
                    num = os.writev(self._stdin, pieces[first : first + _MAX_PIECES])
                except BlockingIOError:
                    num = 0
                except BrokenPipeError as error:
                    raise ProgramError(self._last_words("closed its stdin")) from error
                left -= num
                while num:  # drop what is written
                    size = len(pieces[first])
                    if num < size:
                        pieces[first] = memoryview(pieces[first])[num:]
                        break
                    num, first = num - size, first + 1
                if left:
                    self._wait(deadline, f"read only {total - left} of {total} bytes from its stdin")
        finally:
            self._poll.unregister(self._stdin)

    def receive(self, num: int, deadline: Deadline) -> bytes:
        """Take `num` bytes of what the program writes to stdout. Raises ProgramError where it ends, closes its stdout,
        or hasn't written them by the deadline.
        """
        while len(self._received) < num:
            self._wait(deadline, f"wrote only {len(self._received)} of {num} bytes of an answer"
                       if self._received else "gave no answer")  # fmt: skip
        taken = bytes(self._received[:num])
        del self._received[:num]
        return taken

    def _wait(self, deadline: Deadline, unfinished: str) -> None:
        """Wait until something happens, and take what the program wrote."""
        ready = self._ready(deadline)
        if not ready or deadline.left_s < 0:
            raise ProgramError(f"{unfinished} within {deadline.seconds:g} s")
        if self._stderr in ready:
            self._drain_stderr()
        if ready & {self._stdout, self._exit} and not self._take_stdout():
            raise ProgramError(self._last_words("closed its stdout"))
        if self._exit in ready and self._stdout not in ready:
            raise ProgramError(self._last_words("ended"))

    def _ready(self, deadline: Deadline) -> set[int]:
        return {fd for fd, _ in self._poll.poll(max(deadline.left_s, 0) * 1000)}

    def _take_stdout(self) -> bool:
        """Read what is there; tells whether more can come."""
        try:
            data = os.read(self._stdout, _READ_BYTES)
        except BlockingIOError:
            return True
        self._received += data
        if len(self._received) > self._max_unread:
            raise ProgramError(f"wrote {len(self._received)} bytes to its stdout that nobody asked for")
        return bool(data)

    def _drain_stderr(self) -> None:
        """Keep what is there, but not of a flood without end."""
        for _ in range(_READS_AT_ONCE):
            try:
                data = os.read(self._stderr, _READ_BYTES)
            except BlockingIOError:
                return
            if not data:
                self._ignore(self._stderr)
                return
            self._kept.add(data)

    def _ignore(self, fd: int) -> None:
        """Watch a file no more: its other end is closed, which would wake us up all the time."""
        with suppress(KeyError):
            self._poll.unregister(fd)

    def _last_words(self, what: str) -> str:
        """Say how the program ended; `what` where it didn't."""
        if not self._exits_within(_LAST_WORDS_S):
            return what
        self.kill()
        code = self._popen.returncode
        code = 128 - code if code < 0 else code
        name = next((f" ({s.name})" for s in signal.Signals if s == code - 128), "")
        return f"exited with {code}{name}"

    def _exits_within(self, seconds: float) -> bool:
        """Wait for the process's end, meanwhile taking what it still writes."""
        deadline = Deadline(seconds)
        while True:
            ready = self._ready(deadline)
            self._drain_stderr()
            if self._exit in ready:
                return True
            self._received.clear()
            if self._stdout in ready and not self._take_stdout():
                self._ignore(self._stdout)
            if deadline.left_s <= 0:
                return False

    def cpu_ns(self) -> int | None:
        """CPU time [ns] that the program has used, all of its threads, but not the programs that it runs; `None`: the
        system doesn't tell.
        """
        # The clock of another process on Linux, see MAKE_PROCESS_CPUCLOCK in its posix-timers.h.
        with suppress(OSError):
            return time.clock_gettime_ns(~self._popen.pid << 3 | 2)
        return None

    def close(self, grace_s: float) -> None:
        """Close stdin, which asks it to exit; then terminate, then kill. Takes at most twice `grace_s`."""
        if self._ended:
            return
        try:
            self._files[0].close()
            if not self._exits_within(grace_s):
                self._signal(signal.SIGTERM)
                self._exits_within(grace_s)
        finally:
            self.kill()

    def _signal(self, number: signal.Signals) -> None:
        with suppress(ProcessLookupError, PermissionError):  # all have ended, or became another user's
            os.killpg(self._popen.pid, number)

    def kill(self) -> None:
        """End it at once with all that it started: its group, and what left that as daemons do, unless that cleared its
        environment. Leaves no zombie and no open pipe behind.
        """
        if self._ended:
            return
        self._signal(signal.SIGKILL)  # the group's number is taken until its leader is waited for
        self._popen.wait()
        for environment in Path("/proc").glob("[0-9]*/environ"):
            with suppress(OSError):  # has ended, or is another user's
                if f"{_MARK}={self._mark}".encode() in environment.read_bytes().split(b"\0"):
                    os.kill(int(environment.parent.name), signal.SIGKILL)
        self._ended = True
        self._drain_stderr()
        for file in self._files:
            file.close()
        os.close(self._exit)
