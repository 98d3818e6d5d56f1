"""`--isolate`: a Python plug-in in a process of its own, driven and watched like the programs of `exec`."""

import json
import sys
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from fbench.pipelines.external import fbench_exec_pb2 as schema
from fbench.pipelines.external import messages
from fbench.pipelines.external.messages import ProtocolError
from fbench.pipelines.external.process import Command, ProgramError
from fbench.pipelines.external.session import Session, require
from fbench.replay.contracts import errors
from fbench.replay.contracts.devices import current_execution, note_provider
from fbench.replay.contracts.errors import ConfigError, ReportedError, one_line
from fbench.replay.contracts.plugins import CLOSE_TIMEOUT_S, close_at_end
from fbench.replay.contracts.protocols import Pipeline
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.rig import LogInfo, Rig

_HOST = "fbench.pipelines.external.host"
_START_TIMEOUT_S = 60.0  # To import and start the plug-in, and for what it compiles in its first frame
_GRACE_S = 2.0  # To exit; then the process is terminated, and then killed
_MAX_RESPONSE_BYTES = 64 << 20
_OWN = {c.__name__: c for c in vars(errors).values() if isinstance(c, type) and issubclass(c, errors.FbenchError)}
"""Errors that a plug-in may raise on purpose, by name."""


class Isolated:
    """A pipeline by its name, made and run in another process; it gives what it would give in this one.

    A frame on which the process dies or takes too long fails, and before the next frame it is started again. Raises
    ConfigError where the plug-in can't be made, or needs the log.
    """

    def __init__(self, name: str, settings: list[str], frame_timeout_s: float) -> None:
        words = [sys.executable, "-P", "-m", _HOST, current_execution().device, name, *settings]
        self._session = Session(Command(sys.executable, words, name, is_own=True), _MAX_RESPONSE_BYTES)
        self._frame_timeout_s, self._first_timeout_s = frame_timeout_s, frame_timeout_s + _START_TIMEOUT_S
        try:
            made = self._ask("made", _START_TIMEOUT_S)
            self.parameters, uses_log = dict[str, object](made["parameters"]), bool(made["uses_log"])
            if uses_log:
                raise ConfigError(
                    f"pipeline '{name}' reads the log itself, so it can't be isolated; leave out --isolate"
                )
        except (ReportedError, KeyError, TypeError, ValueError) as error:
            self._session.kill()
            raise ConfigError(f"pipeline '{name}' can't be made: {one_line(error)}") from error
        except BaseException:
            self._session.kill()
            raise

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Start the plug-in, or tell it of another rig."""
        self._hello = messages.hello(rig, log_info)
        self._request("ready", _START_TIMEOUT_S, hello=self._hello)
        for provider in self._ask("providers", self._frame_timeout_s):
            note_provider(str(provider))

    def reset(self, reason: str) -> None:
        """Have the plug-in forget all tracks; one whose process was lost has none."""
        if self._session.is_running:
            self._request("done", self._frame_timeout_s, reset=schema.Reset(reason=reason))

    def step(self, frame: Frame) -> Output:
        """Have the plug-in process a frame, after starting it again if it was lost."""
        if not self._session.is_running:
            self._start_again()
        timeout_s, self._first_timeout_s = self._first_timeout_s, self._frame_timeout_s
        shown = messages.decode_videos(frame)
        response = self._request("output", timeout_s, shown.frame)
        return shown.complete(messages.read_output(response.output))

    def close(self) -> None:
        """Close the plug-in, and end its process with all that it started."""
        try:
            if self._session.is_running and not self._session.is_waiting:
                self._ask("close", CLOSE_TIMEOUT_S)
        finally:
            self._session.close(_GRACE_S)

    def identity(self) -> Mapping[str, object]:
        """What the plug-in says of itself, if anything."""
        return dict(self._ask("identity", self._frame_timeout_s))

    def required_sensors(self) -> Collection[str] | None:
        """Sensors that the plug-in needs; `None` where it doesn't say."""
        needed = self._ask("required_sensors", self._frame_timeout_s)
        return None if needed is None else list(map(str, needed))

    @property
    def is_tracker(self) -> bool | None:
        """Whether the plug-in tracks; `None` where it doesn't say."""
        says = self._ask("is_tracker", self._frame_timeout_s)
        return None if says is None else bool(says)

    def cpu_ns(self) -> int | None:
        """CPU time [ns] of the program so far; `None`: unknown."""
        return self._session.cpu_ns()

    def stderr(self) -> bytes:
        """What the plug-in printed: the first and the last 512 KiB."""
        return self._session.stderr()

    def _start_again(self) -> None:
        self._request("ready", _START_TIMEOUT_S, hello=self._hello)
        self.reset("the plug-in was started again")

    def _ask(self, question: str, timeout_s: float) -> Any:
        if not self._session.is_running and question != "made":
            self._start_again()
        response = self._request("answer", timeout_s, question=schema.Question(name=question))
        try:
            return json.loads(response.answer.json)
        except (ValueError, RecursionError) as error:
            raise ReportedError(f"{question}: answered with no JSON") from error

    def _request(self, expected: str, timeout_s: float, frame: Frame | None = None, **small: Any) -> schema.Response:
        """Return the response. Raises the errors of fbench that mean the same here. Raises ReportedError for any other,
        and where the process was lost.
        """
        try:
            with self._session.watch():
                response = self._session.exchange(timeout_s, frame, **small)
                if response.WhichOneof("kind") != "error":
                    return require(response, expected)
        except (ProgramError, ProtocolError) as error:
            raise ReportedError(str(error)) from error
        if (own := _OWN.get(response.error_type)) is not None:
            raise own(response.error, response.error_code)
        raise ReportedError(response.error)


@contextmanager
def open_isolated(
    name: str, settings: list[str], frame_timeout_s: float
) -> Iterator[tuple[Pipeline, dict[str, object]]]:
    """Build a pipeline in a process of its own, and close it at the end, as `open_pipeline` does in this one."""
    pipeline = Isolated(name, settings, frame_timeout_s)
    with close_at_end(pipeline, name):
        yield pipeline, pipeline.parameters
