"""A process that replays cells, one after the other."""

import os
import subprocess
import sys
import tempfile
from contextlib import suppress

from fbench.api.suites.cells import RESPONSE, Response
from fbench.replay.geometry.threads import VARIABLE
from fbench.replay.setup.request import ReplayRequest

WORKER = "fbench.api.suites.worker"
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", VARIABLE), "1")
_PATIENCE_S = 10.0  # For a process that is told to end, to clean up
_LAST_BYTES = 4000


class Worker:
    """One process at a time; a process that dies takes only its cell with it. It runs `module`: a line with a cell on
    stdin, a line with a response on stdout; of the messages that several cells need it keeps up to `max_bytes`.
    """

    def __init__(self, module: str = WORKER, max_bytes: int = 0) -> None:
        self._module, self._max_bytes = module, max_bytes
        self._process: subprocess.Popen[str] | None = None
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115  # closed by `close`
        self._stderr_start = 0

    def replay(self, cell: ReplayRequest) -> Response:
        """Have a cell replayed."""
        if self._process is None:
            # In a session of its own, so that Ctrl-C reaches us alone, and we end it.
            command = [sys.executable, "-P", "-m", self._module, str(self._max_bytes)]
            self._process = subprocess.Popen(  # noqa: S603  # a module of ours
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._stderr, encoding="utf-8",
                errors="replace", env={**os.environ, **_ONE_THREAD}, start_new_session=True,
            )  # fmt: skip
        process = self._process
        self._stderr_start = self._num_bytes_on_stderr()
        try:
            print(cell.to_json(), file=process.stdin, flush=True)
            line = process.stdout.readline() if process.stdout else ""
        except OSError:  # it has died
            line = ""
        if not line.endswith("\n"):
            reason = self._why_dead(process)
        else:
            try:
                return RESPONSE.validate_json(line)
            except ValueError:  # no answer of ours; which answer is whose can't be told any more
                self.end()
                reason = f"its process wrote {line[:80]!r} where an answer was expected"
        self._forget()
        return Response(reason)

    def end(self) -> None:
        """End the process; what it was writing is cleared away."""
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(_PATIENCE_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def close(self) -> None:
        """End the process, and close what was open to it."""
        self.end()
        self._forget()
        self._stderr.close()

    def _forget(self) -> None:
        for pipe in (self._process.stdin, self._process.stdout) if self._process else ():
            if pipe is not None:
                with suppress(BrokenPipeError):  # what it didn't read any more
                    pipe.close()
        self._process = None

    def _why_dead(self, process: subprocess.Popen[str]) -> str:
        """How it ended, and the last that it said of the cell at hand."""
        code = process.wait()
        begin = max(self._stderr_start, self._num_bytes_on_stderr() - _LAST_BYTES)
        said = os.pread(self._stderr.fileno(), _LAST_BYTES, begin).decode(errors="replace")
        lines = [line for line in said.splitlines() if line.strip()]
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        return f"its process ended with {how}{f': {lines[-1]}' if lines else ''}"

    def _num_bytes_on_stderr(self) -> int:
        return os.fstat(self._stderr.fileno()).st_size
