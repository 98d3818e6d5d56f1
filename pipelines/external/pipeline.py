"""`exec`: any program as a pipeline, watched, and started again where it fails."""

import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar

from fbench.pipelines.external import fbench_exec_pb2 as schema
from fbench.pipelines.external import messages
from fbench.pipelines.external.messages import ProtocolError
from fbench.pipelines.external.process import Deadline, KeptText, Process, ProgramError, parse_command
from fbench.replay.contracts.errors import DataError, FbenchError, LogError, RunError
from fbench.replay.contracts.params import CheckedParams, in_range
from fbench.replay.contracts.settings import describe_file
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.rig import LogInfo, Rig

_LENGTH = struct.Struct("<I")
_MAX_REQUEST_BYTES = 2**31 - 1  # What protobuf can read
_MAX_ERROR_CHARS = 500
_MIB = 1 << 20
_MAX_NAME_CHARS = 200

__all__ = ["ProgramError", "ProtocolError", "RefusedError"]


class RefusedError(FbenchError):
    """The program says that it can't do what it was asked for."""


@dataclass(frozen=True)
class ExecParams(CheckedParams):
    """Parameters of `exec`."""

    command: str = ""  # The program with its arguments, split as a shell does; found in PATH, or as a path.
    frame_timeout_s: float = in_range(10.0, 0.001)
    """A program that takes longer for a frame [s] is killed and started again."""
    start_timeout_s: float = in_range(60.0, 0.001)  # So long [s] it may take to be ready.
    close_timeout_s: float = in_range(2.0, 0.001)
    """So long [s] it may take to exit when its stdin is closed, and again when it is terminated; then it is killed."""
    max_response_mib: int = in_range(64, 1, 1024)  # Longer answers [MiB] are refused.


class Exec:
    """Runs a program in lockstep over its stdin and stdout, as docs/exec.md describes.

    A frame on which the program crashes, hangs or gives garbage fails, and before the next frame it is started again.
    Raises ConfigError where there is no such program.
    """

    argument: ClassVar[str] = "command"

    def __init__(self, params: ExecParams = ExecParams()) -> None:
        self._params = params
        self._command = parse_command(params.command)
        self._kept = KeptText()
        self._process: Process | None = None
        self._max_response_bytes, self._sequence = params.max_response_mib * _MIB, 0
        self._stages: tuple[str, ...] = ()
        self._identity: dict[str, object] = {}

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Start the program, or tell it of another rig. Raises LogError where the program says that it can't work with
        this log. Raises RunError where it ends, hangs or speaks another version.
        """
        self._hello = messages.hello(rig, log_info)
        try:
            with self._watch():
                ready = self._greet()
        except RefusedError as error:
            self._kill()
            raise LogError(str(error)) from error
        except (ProgramError, ProtocolError) as error:
            raise RunError(f"exec: can't start: {error}") from error
        # Files may be built anew while the run goes on.
        self._identity = self._identity or {
            "program.name": ready.name[:_MAX_NAME_CHARS],
            "program.files": [describe_file(path) for path in self._command.files],
        }

    def reset(self, reason: str) -> None:
        """Have the program forget all tracks; one that was lost has none."""
        if self._process is None:
            return
        try:
            with self._watch():
                self._reset(reason)
        except RefusedError:
            self._kill()  # it may still hold what it should have forgotten
            raise

    def step(self, frame: Frame) -> Output:
        """Have the program process a frame, after starting it again if it was lost. Raises ProgramError where it
        crashes or hangs. Raises ProtocolError where it doesn't keep to the protocol. Raises RefusedError where it says
        that it can't do this frame. Raises DataError where boxes are incomplete or not finite.
        """
        with self._watch():
            if self._process is None:
                try:
                    self._greet()
                    self._reset("the program was started again")
                except RefusedError:
                    self._kill()
                    raise
            shown = messages.decode_videos(frame)
            output = self._ask("output", self._params.frame_timeout_s, shown.frame).output
        result = shown.complete(messages.to_output(output))
        # Each name of a stage becomes a column of the run: they may not be new in every frame.
        names = dict.fromkeys([*self._stages, *result.stage_ns])
        if len(names) > messages.MAX_STAGES:
            raise DataError(
                f"stages: over {messages.MAX_STAGES} different names in the run, such as '{list(names)[-1]}'"
            )
        self._stages = tuple(names)
        return result

    def close(self) -> None:
        """End the program."""
        process, self._process = self._process, None
        if process is not None:
            process.close(self._params.close_timeout_s)

    def identity(self) -> Mapping[str, object]:
        """Name that the program gave itself at the start, and its files, so that two builds of it can be told apart."""
        return self._identity

    def stderr(self) -> bytes:
        """What the program wrote to stderr in all its lives: the first and the last 512 KiB."""
        return self._kept.text()

    def _greet(self) -> schema.Ready:
        ready = self._ask("ready", self._params.start_timeout_s, hello=self._hello).ready
        if ready.version != self._hello.version:
            raise ProtocolError(f"speaks version {ready.version} of the protocol, expected {self._hello.version}")
        return ready

    def _reset(self, reason: str) -> None:
        self._ask("done", self._params.frame_timeout_s, reset=schema.Reset(reason=reason))

    def _ask(self, expected: str, timeout_s: float, frame: Frame | None = None, **small: Any) -> schema.Response:
        """Send the next request, with a frame or what is `small`, and return the response; starts the program first
        where it isn't running. Raises ConfigError where it can't be executed. Raises ProgramError, ProtocolError or
        RefusedError where it doesn't answer as `expected`.
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
        deadline = Deadline(timeout_s)
        self._process.send([_LENGTH.pack(num), *request], deadline)
        head = self._process.receive(_LENGTH.size, deadline)
        (num,) = _LENGTH.unpack(head)
        if num > self._max_response_bytes:
            is_text = all(32 <= byte < 127 or byte in b"\t\r\n" for byte in head)
            hint = f" ({head.decode()!r}: does it print to stdout?)" if is_text else ""
            most = self._max_response_bytes
            raise ProtocolError(f"announced an answer of {num} bytes{hint}, at most {most} are taken")
        response = messages.parse_response(self._process.receive(num, deadline), self._sequence)
        kind = response.WhichOneof("kind")
        if kind == "error":
            raise RefusedError(f"says: {response.error[:_MAX_ERROR_CHARS]}")
        if kind != expected:
            raise ProtocolError(f"answered with {kind}, expected {expected}")
        return response

    @contextmanager
    def _watch(self) -> Iterator[None]:
        """Kill a program that can't be trusted any more, and say what it said last."""
        try:
            yield
        except (ProgramError, ProtocolError) as error:
            self._kill()
            last = f"; last line on stderr: {self._kept.last_line}" if self._kept.last_line else ""
            raise type(error)(f"{self._command.name} {error}{last}") from error
        except RefusedError as error:
            raise RefusedError(f"{self._command.name} {error}") from error

    def _kill(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.kill()
