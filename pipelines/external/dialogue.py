"""One request, one answer: lengths, numbers and limits."""

import struct

from fbench.pipelines.external import fbench_exec_pb2 as schema
from fbench.pipelines.external.command import Command
from fbench.pipelines.external.process import Deadline, Process, ProgramError
from fbench.pipelines.external.requests import Pieces, frame_request, small_request
from fbench.pipelines.external.responses import ProtocolError, parse_response
from fbench.pipelines.external.stderr import KeptText
from fbench.replay.data import Frame
from fbench.replay.errors import FbenchError

_LENGTH = struct.Struct("<I")
_MAX_REQUEST_BYTES = 2**31 - 1
"""What protobuf can read."""
_MAX_ERROR_CHARS = 500


class RefusedError(FbenchError):
    """The program says that it can't do what it was asked for."""


class Dialogue:
    """A running program and the number of the next request.

    Args:
        command: What to run.
        stderr: Keeps what it writes there.
        max_response_bytes: Longer answers are refused.

    Raises:
        ConfigError: where the program can't be executed.
    """

    def __init__(self, command: Command, stderr: KeptText, max_response_bytes: int) -> None:
        self.process = Process(command, stderr, 2 * max_response_bytes)
        self._max_response_bytes = max_response_bytes
        self._sequence = 0

    def greet(self, hello: schema.Hello, timeout_s: float) -> schema.Ready:
        """Say hello.

        Raises:
            ProgramError, ProtocolError, RefusedError: where the program isn't ready, or speaks another version.
        """
        ready = self._ask(small_request(self._next(), hello), timeout_s, "ready").ready
        if ready.version != hello.version:
            raise ProtocolError(f"speaks version {ready.version} of the protocol, expected {hello.version}")
        return ready

    def reset(self, reason: str, timeout_s: float) -> None:
        """Have it forget all tracks.

        Raises:
            ProgramError, ProtocolError, RefusedError: where it doesn't.
        """
        self._ask(small_request(self._next(), schema.Reset(reason=reason)), timeout_s, "done")

    def step(self, frame: Frame, timeout_s: float) -> schema.Output:
        """Have it process one frame.

        Raises:
            ProgramError, ProtocolError, RefusedError: where it doesn't.
        """
        return self._ask(frame_request(self._next(), frame), timeout_s, "output").output

    def _next(self) -> int:
        self._sequence += 1
        return self._sequence

    def _ask(self, request: Pieces, timeout_s: float, expected: str) -> schema.Response:
        num = sum(map(len, request))
        if num > _MAX_REQUEST_BYTES:
            raise RefusedError(f"a frame of {num} bytes is too large for a request, which can have 2 GiB")
        deadline = Deadline(timeout_s)
        self.process.send([_LENGTH.pack(num), *request], deadline)
        response = parse_response(self._received(deadline), self._sequence)
        kind = response.WhichOneof("kind")
        if kind == "error":
            raise RefusedError(f"says: {response.error[:_MAX_ERROR_CHARS]}")
        if kind != expected:
            raise ProtocolError(f"answered with {kind}, expected {expected}")
        return response

    def _received(self, deadline: Deadline) -> bytes:
        head = self.process.receive(_LENGTH.size, deadline)
        (num,) = _LENGTH.unpack(head)
        if num > self._max_response_bytes:
            is_text = all(32 <= byte < 127 or byte in b"\t\r\n" for byte in head)
            hint = f" ({head.decode()!r}: does it print to stdout?)" if is_text else ""
            raise ProtocolError(
                f"announced an answer of {num} bytes{hint}, at most {self._max_response_bytes} are taken"
            )
        return self.process.receive(num, deadline)


__all__ = ["Dialogue", "ProgramError", "ProtocolError", "RefusedError"]
