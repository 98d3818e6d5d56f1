"""Lockstep with one program: a request, its response, and a new start where the program can't be trusted any more."""

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from fbench.pipelines.external import fbench_exec_pb2 as schema
from fbench.pipelines.external import messages
from fbench.pipelines.external.messages import ProtocolError
from fbench.pipelines.external.process import Command, Deadline, KeptText, Process, ProgramError
from fbench.replay.contracts.errors import FbenchError
from fbench.replay.data.frames import Frame

LENGTH = struct.Struct("<I")
_MAX_REQUEST_BYTES = 2**31 - 1  # What protobuf can read
_MAX_ERROR_CHARS = 500


class RefusedError(FbenchError):
    """The program says that it can't do what it was asked for."""


class Session:
    """Requests to one program, which is started with the first one and again where it was lost."""

    def __init__(self, command: Command, max_response_bytes: int) -> None:
        self._command, self._max_response_bytes = command, max_response_bytes
        self._kept = KeptText()
        self._process: Process | None = None
        self._sequence = 0
        self.is_waiting = False  # For a response: it stays so where something else ends the wait

    @property
    def is_running(self) -> bool:
        """Whether the program was started, and not lost since then."""
        return self._process is not None

    def cpu_ns(self) -> int | None:
        """CPU time [ns] of the program that runs, see `Process.cpu_ns`; `None`: unknown, or none runs."""
        return None if self._process is None else self._process.cpu_ns()

    def exchange(self, timeout_s: float, frame: Frame | None = None, **small: Any) -> schema.Response:
        """Send the next request, with a frame or what is `small`, and return the response, an error too; starts the
        program first where it isn't running. Raises ConfigError where it can't be executed. Raises RefusedError where
        the frame is too large. Raises ProgramError or ProtocolError where the program doesn't answer as it should.
        """
        if self._process is None:
            self._kept.begin()
            self._process, self._sequence = Process(self._command, self._kept, 2 * self._max_response_bytes), 0
        self._sequence += 1
        if frame is None:
            request = messages.small_request(self._sequence, **small)
        else:
            request = messages.frame_request(self._sequence, frame)
        num = sum(map(len, request))
        if num > _MAX_REQUEST_BYTES:
            raise RefusedError(f"a frame of {num} bytes is too large for a request, which can have 2 GiB")
        deadline, self.is_waiting = Deadline(timeout_s), True
        self._process.send([LENGTH.pack(num), *request], deadline)
        head = self._process.receive(LENGTH.size, deadline)
        (num,) = LENGTH.unpack(head)
        if num > self._max_response_bytes:
            is_text = all(32 <= byte < 127 or byte in b"\t\r\n" for byte in head)
            hint = f" ({head.decode()!r}: does it print to stdout?)" if is_text else ""
            most = self._max_response_bytes
            raise ProtocolError(f"announced an answer of {num} bytes{hint}, at most {most} are taken")
        response = messages.parse_response(self._process.receive(num, deadline), self._sequence)
        self.is_waiting = False
        return response

    def ask(self, expected: str, timeout_s: float, frame: Frame | None = None, **small: Any) -> schema.Response:
        """Return the response as `exchange` does. Raises RefusedError where it is an error, and ProtocolError where it
        isn't as `expected`.
        """
        response = self.exchange(timeout_s, frame, **small)
        if response.WhichOneof("kind") == "error":
            raise RefusedError(f"says: {response.error[:_MAX_ERROR_CHARS]}")
        return require(response, expected)

    @contextmanager
    def watch(self) -> Iterator[None]:
        """Kill a program that can't be trusted any more, and say what it said last."""
        try:
            yield
        except (ProgramError, ProtocolError) as error:
            self.kill()
            last = f"; last line on stderr: {self._kept.last_line}" if self._kept.last_line else ""
            raise type(error)(f"{self._command.name} {error}{last}") from error
        except RefusedError as error:
            raise RefusedError(f"{self._command.name} {error}") from error

    def kill(self) -> None:
        """End the program at once."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()

    def close(self, grace_s: float) -> None:
        """End the program, which has twice `grace_s` to exit by itself."""
        process, self._process = self._process, None
        if process is not None:
            process.close(grace_s)

    def stderr(self) -> bytes:
        """What the program wrote to stderr in all its lives: the first and the last 512 KiB."""
        return self._kept.text()


def require(response: schema.Response, expected: str) -> schema.Response:
    """Return a response of the kind that is `expected`. Raises ProtocolError where it is of another."""
    if (kind := response.WhichOneof("kind")) != expected:
        raise ProtocolError(f"answered with {kind}, expected {expected}")
    return response
