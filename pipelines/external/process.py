"""One running program: bytes in and out under a deadline, and a sure end."""

import fcntl
import os
import select
import signal
import subprocess
import time
from contextlib import suppress

from fbench.pipelines.external.command import Command, environment
from fbench.pipelines.external.stderr import KeptText
from fbench.replay.errors import ConfigError, FbenchError

_PIPE_BYTES = 1 << 20
_READ_BYTES = 1 << 16
_READS_AT_ONCE = 16
_MAX_PIECES = 512
"""Buffers a write, below the system's limit."""
_LAST_WORDS_S = 0.5
"""How long a program that closed a pipe has to exit, so that the reason can be told."""


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

    One loop watches all of them and the process itself: nothing that the program does, or fails to do, blocks.

    Args:
        command: What to run.
        stderr: Keeps what it writes there.
        max_unread: So many bytes at most may wait on its stdout for somebody who wants them.

    Raises:
        ConfigError: where the program can't be executed.
    """

    def __init__(self, command: Command, stderr: KeptText, max_unread: int) -> None:
        pipe = subprocess.PIPE
        try:
            self._popen = subprocess.Popen(  # noqa: S603 - the user names the program, and no shell is involved
                command.words, executable=command.program, stdin=pipe, stdout=pipe, stderr=pipe, bufsize=0,
                start_new_session=True, env=environment(),
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
        """Write all pieces to the program's stdin.

        Raises:
            ProgramError: where it ends, closes its stdin, or hasn't read them by the deadline.
        """
        total = sum(map(len, pieces))
        left = total
        first = 0
        self._poll.register(self._stdin, select.POLLOUT)
        try:
            while left:
                num = self._written(pieces[first : first + _MAX_PIECES])
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

    def _written(self, pieces: list[bytes | memoryview]) -> int:
        try:
            return os.writev(self._stdin, pieces)
        except BlockingIOError:
            return 0
        except BrokenPipeError as error:
            raise ProgramError(self._last_words("closed its stdin")) from error

    def receive(self, num: int, deadline: Deadline) -> bytes:
        """Take `num` bytes of what the program writes to stdout.

        Raises:
            ProgramError: where it ends, closes its stdout, or hasn't written them by the deadline.
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
        has_more = self._take_stdout() if ready & {self._stdout, self._exit} else True
        if not has_more:
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
        """End it at once with all that it started in its group; leaves no zombie and no open pipe behind."""
        if self._ended:
            return
        self._signal(signal.SIGKILL)  # the group's number is taken until its leader is waited for
        self._popen.wait()
        self._ended = True
        self._drain_stderr()
        for file in self._files:
            file.close()
        os.close(self._exit)
