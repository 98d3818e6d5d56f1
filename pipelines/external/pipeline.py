"""`exec`: any program as a pipeline, watched, and started again where it fails."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from fbench.pipelines.external import fbench_exec_pb2 as schema
from fbench.pipelines.external import messages
from fbench.pipelines.external.messages import ProtocolError
from fbench.pipelines.external.process import ProgramError, parse_command
from fbench.pipelines.external.session import RefusedError, Session
from fbench.replay.contracts.errors import DataError, LogError, RunError
from fbench.replay.contracts.params import CheckedParams, in_range
from fbench.replay.contracts.settings import describe_file
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.rig import LogInfo, Rig

_MIB = 1 << 20
_MAX_NAME_CHARS = 200

__all__ = ["ProgramError", "ProtocolError", "RefusedError"]


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
        self._session = Session(self._command, params.max_response_mib * _MIB)
        self._stages: tuple[str, ...] = ()
        self._identity: dict[str, object] = {}

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Start the program, or tell it of another rig. Raises LogError where the program says that it can't work with
        this log. Raises RunError where it ends, hangs or speaks another version.
        """
        self._hello = messages.hello(rig, log_info)
        try:
            with self._session.watch():
                ready = self._greet()
        except RefusedError as error:
            self._session.kill()
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
        if not self._session.is_running:
            return
        try:
            with self._session.watch():
                self._reset(reason)
        except RefusedError:
            self._session.kill()  # it may still hold what it should have forgotten
            raise

    def step(self, frame: Frame) -> Output:
        """Have the program process a frame, after starting it again if it was lost. Raises ProgramError where it
        crashes or hangs. Raises ProtocolError where it doesn't keep to the protocol. Raises RefusedError where it says
        that it can't do this frame. Raises DataError where boxes are incomplete or not finite.
        """
        with self._session.watch():
            if not self._session.is_running:
                try:
                    self._greet()
                    self._reset("the program was started again")
                except RefusedError:
                    self._session.kill()
                    raise
            shown = messages.decode_videos(frame)
            output = self._session.ask("output", self._params.frame_timeout_s, shown.frame).output
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
        self._session.close(self._params.close_timeout_s)

    def identity(self) -> Mapping[str, object]:
        """Name that the program gave itself at the start, and its files, so that two builds of it can be told apart."""
        return self._identity

    def cpu_ns(self) -> int | None:
        """CPU time [ns] of the program so far; `None`: unknown."""
        return self._session.cpu_ns()

    def stderr(self) -> bytes:
        """What the program wrote to stderr in all its lives: the first and the last 512 KiB."""
        return self._session.stderr()

    def _greet(self) -> schema.Ready:
        ready = self._session.ask("ready", self._params.start_timeout_s, hello=self._hello).ready
        if ready.version != self._hello.version:
            raise ProtocolError(f"speaks version {ready.version} of the protocol, expected {self._hello.version}")
        return ready

    def _reset(self, reason: str) -> None:
        self._session.ask("done", self._params.frame_timeout_s, reset=schema.Reset(reason=reason))
