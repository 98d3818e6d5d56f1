"""Processes that replay cells, each one cell after the other."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import Lock

from fbench.replay.suites.cell import Answer, Cell
from fbench.replay.threads import VARIABLE

_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", VARIABLE), "1")
_PATIENCE_S = 10.0
"""For a process that is told to end, to clean up."""
_LAST_BYTES = 4000


class Worker:
    """One process at a time; a process that dies takes only its cell with it."""

    def __init__(self, module: str) -> None:
        self._module = module
        self._process: subprocess.Popen[str] | None = None
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115  # closed by `close`
        self._said_before = 0

    def replay(self, cell: Cell) -> Answer:
        """Have a cell replayed."""
        process = self._running()
        self._said_before = self._num_said()
        try:
            print(cell.to_json(), file=process.stdin, flush=True)
            line = process.stdout.readline() if process.stdout else ""
        except OSError:  # it has died
            line = ""
        if not line.endswith("\n"):
            return self._failed(self._why_dead(process))
        try:
            return Answer.from_json(line)
        except ValueError:  # no answer of ours; which answer is whose can't be told any more
            self.end()
            return self._failed(f"its process wrote {line[:80]!r} where an answer was expected")

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

    def _failed(self, reason: str) -> Answer:
        self._forget()
        return Answer(reason)

    def _forget(self) -> None:
        """Close the pipes of a process that has ended."""
        for pipe in (self._process.stdin, self._process.stdout) if self._process else ():
            if pipe is not None:
                with suppress(BrokenPipeError):  # what it didn't read any more
                    pipe.close()
        self._process = None

    def _running(self) -> subprocess.Popen[str]:
        if self._process is None:
            # In a session of its own, so that Ctrl-C reaches us alone, and we end it.
            self._process = subprocess.Popen(  # noqa: S603  # a module of ours
                [sys.executable, "-P", "-m", self._module], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                stderr=self._stderr, encoding="utf-8", errors="replace", env={**os.environ, **_ONE_THREAD},
                start_new_session=True,
            )  # fmt: skip
        return self._process

    def _why_dead(self, process: subprocess.Popen[str]) -> str:
        """How it ended, and the last that it said of the cell at hand."""
        code = process.wait()
        begin = max(self._said_before, self._num_said() - _LAST_BYTES)
        said = os.pread(self._stderr.fileno(), _LAST_BYTES, begin).decode(errors="replace")
        lines = [line for line in said.splitlines() if line.strip()]
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        return f"its process ended with {how}{f': {lines[-1]}' if lines else ''}"

    def _num_said(self) -> int:
        """Bytes on stderr, of all cells so far."""
        return os.fstat(self._stderr.fileno()).st_size


class Workers:
    """Lends workers to threads."""

    def __init__(self, module: str) -> None:
        self._module = module
        self._all: list[Worker] = []
        self._idle: list[Worker] = []
        self._lock = Lock()

    @contextmanager
    def lent(self) -> Iterator[Worker]:
        """Lend a worker that nobody else has."""
        with self._lock:
            if not self._idle:
                self._idle.append(Worker(self._module))
                self._all.append(self._idle[0])
            worker = self._idle.pop()
        try:
            yield worker
        finally:
            with self._lock:
                self._idle.append(worker)

    def end(self) -> None:
        """End all processes."""
        with self._lock:
            for worker in self._all:
                worker.end()

    def close(self) -> None:
        """End all processes, once no thread has one any more."""
        for worker in self._all:
            worker.close()
