"""Suites: cells that are there stay, the others are replayed, a few at a time, by worker processes."""

import inspect
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from hashlib import blake2b
from importlib.util import find_spec
from pathlib import Path
from threading import Event, Lock
from typing import Self

from pydantic import TypeAdapter

from fbench.api.cells import RESPONSE, RUN_SEAL, CellResult, Response, folder_of, is_sealed_run, seal_run
from fbench.replay.conditions.spec import parse_conditions
from fbench.replay.contracts.errors import ConfigError, FbenchError, one_line
from fbench.replay.contracts.plugins import pipeline_class, pipeline_parameters
from fbench.replay.contracts.protocols import KeepsStderr
from fbench.replay.contracts.sensor_settings import make_sensors
from fbench.replay.contracts.variants import sensors_of
from fbench.replay.data.files import Draft
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.formats.text import digest_of
from fbench.replay.geometry.kernels import VARIABLE
from fbench.replay.runs.manifest import describe_host, package_versions
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import log_source

_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", VARIABLE), "1")
_PATIENCE_S = 10.0  # For a process that is told to end, to clean up
_LAST_BYTES = 4000


class Worker:
    """One process at a time; a process that dies takes only its cell with it."""

    def __init__(self, module: str) -> None:
        self._module = module
        self._process: subprocess.Popen[str] | None = None
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115  # closed by `close`
        self._stderr_start = 0

    def replay(self, cell: ReplayRequest) -> Response:
        """Have a cell replayed."""
        if self._process is None:
            # In a session of its own, so that Ctrl-C reaches us alone, and we end it.
            self._process = subprocess.Popen(  # noqa: S603  # a module of ours
                [sys.executable, "-P", "-m", self._module], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                stderr=self._stderr, encoding="utf-8", errors="replace", env={**os.environ, **_ONE_THREAD},
                start_new_session=True,
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


FORMAT = 1  # Of what is written about a run's content; another number replays all
_OWN = "fbench"
_OPTIONS_OF_RUN = (
    "detect_every", "reference", "timeout_ms", "tolerance_ms", "max_gap_s", "offset", "stamps", "from_", "to", "frames",
    "interpolate_truth_ms", "on_fault", "fault_budget", "redact", "seed",
)  # fmt: skip
"""Fields of a request that decide what its run holds, beside those that are digested."""
_PACKAGES = ("fbench.replay", "fbench.pipelines", "fbench.metrics", "fbench.api", "fbench.cli")
"""Those that decide what is in a run folder; weights inside them count, too."""
_OPTIONS = TypeAdapter(ScoreOptions)

Content = dict[str, object]


class Contents:
    """Tells what cells are made of; looks at each log, and at the code, once."""

    def __init__(self) -> None:
        self._digest_of: Callable[[Path], str] = cache(digest_of)
        self._package_of: Callable[[str], str] = cache(self._package)
        self._around: Content = {
            "code": {name: self._package(name) for name in _PACKAGES},
            "versions": package_versions(),
            "cpu": describe_host()["cpu"],
        }

    def of(self, cell: ReplayRequest) -> Content | None:
        """Return all that decides a cell's run, JSON-ready; `None` where nobody can tell: a pipeline that is a program
        may give something else each time, and a plug-in that is isolated isn't imported here. Raises FbenchError where
        log, pipeline or parameters can't be used.
        """
        if cell.isolate or isinstance(cls := pipeline_class(cell.pipeline), KeepsStderr):
            return None
        source = log_source(cell.log)
        truth = source.truth_entry()
        return {
            "format": FORMAT,
            "log": self._digest_of(cell.log.path),
            "topics": list(cell.log.topics),
            "inputs": [entry.model_dump() for entry in source.input_entries()],
            "truth": None if truth is None else truth.model_dump(),
            "pipeline": cell.pipeline,
            "source": self._source(cls),
            "parameters": pipeline_parameters(cell.pipeline, list(cell.settings)),
            "sensors": sensors_of(cell.pipeline, make_sensors(cell.sensors)),
            "conditions": [
                [part.id, dict(part.level), part.sensors, part.from_ns, part.to_ns, self._source(type(part.condition))]
                for part in parse_conditions(cell.condition)
            ],
            "options": {name: getattr(cell, name) for name in _OPTIONS_OF_RUN},
            "scoring": _OPTIONS.dump_python(cell.scoring, mode="json"),
            "media": not cell.no_media,
            **self._around,
        }

    def _source(self, cls: type) -> str:
        """Digest of the package that holds the class, or of its file; it may be anybody's."""
        package = cls.__module__.partition(".")[0]
        if package == _OWN:
            return ""  # counts already
        file = Path(inspect.getfile(cls))
        is_alone = "." not in cls.__module__ and file.name != "__init__.py"
        return self._digest_of(file) if is_alone else self._package_of(package)

    @staticmethod
    def _package(package: str) -> str:
        spec = find_spec(package)
        places = [] if spec is None or spec.submodule_search_locations is None else spec.submodule_search_locations
        whole = blake2b(digest_size=16)
        for folder in map(Path, places):
            # Without what Python compiles and others write while we look.
            for name in sorted(file.relative_to(folder) for file in folder.rglob("*") if file.is_file()):
                if "__pycache__" not in name.parts:
                    whole.update(f"{name.as_posix()}\n{digest_of(folder / name)}\n".encode())
        return whole.hexdigest()


def key_of(content: Content) -> str:
    """Return the digest of a content."""
    text = json.dumps(content, sort_keys=True, allow_nan=False)
    return blake2b(text.encode("utf-8", "surrogatepass"), digest_size=16).hexdigest()


WORKER = "fbench.api.suite_worker"


def run_suite(
    cells: Sequence[ReplayRequest],
    num_workers: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
    module: str = WORKER,
) -> list[CellResult]:
    """Replay the cells whose runs aren't there, and return what became of all, in their order. A cell is there if its
    folder holds a whole run of equal content: log, files beside it, pipeline, parameters with weights, options of
    scoring, code and versions. What is damaged or of other content is replaced. A cell that fails doesn't stop the
    others; nor does one of known content that somebody changes before the suite ends, such as by `fbench score` with
    other options: its numbers would be of other rules than the rest. Runs are equal for any number of workers
    (processes at a time, each on one thread), apart from what is measured. `progress` gets how many cells are done, and
    of how many; a process runs `module`: a line with a cell on stdin, a line with an answer on stdout. Raises
    ConfigError where two cells have one folder, or there is no worker.
    """
    if num_workers < 1:
        raise ConfigError(f"--workers {num_workers}: expected at least 1")
    known: set[Path] = set()
    for cell in cells:
        if (folder := folder_of(cell).absolute()) in known:
            raise ConfigError(f"two cells of a suite go to {folder_of(cell)}; give each a folder of its own")
        known.add(folder)
    progress(0, len(cells))
    contents = Contents()
    with _Suite(num_workers, module) as suite:
        begun: list[tuple[Future[CellResult], _Forecast]] = []
        for cell in cells:
            forecast = _Forecast.of(cell, contents)
            begun.append((suite.pool.submit(suite.result, cell, forecast), forecast))
        for num, _ in enumerate(as_completed([future for future, _ in begun]), 1):
            progress(num, len(cells))
        results = [future.result() for future, _ in begun]
        return list(suite.pool.map(_check, results, [forecast for _, forecast in begun]))


@dataclass(frozen=True)
class _Forecast:
    content: Content | None = None
    error: str | None = None

    @property
    def key(self) -> str | None:
        """Of the run that it gives; `None` where nobody can tell."""
        return None if self.content is None else key_of(self.content)

    @classmethod
    def of(cls, cell: ReplayRequest, contents: Contents) -> "_Forecast":
        try:
            return cls(contents.of(cell))
        except FbenchError as error:
            return cls(error=str(error))
        except Exception as error:  # noqa: BLE001  # a plug-in may raise anything, and mustn't stop the rest
            return cls(error=one_line(error))


class _Suite:
    """Replays cells, a few at a time; where its `with` block ends early, no process is left and none begins."""

    def __init__(self, num_workers: int, module: str) -> None:
        self.pool, self._module = ThreadPoolExecutor(num_workers), module
        self._workers: list[Worker] = []
        self._idle: list[Worker] = []
        self._lock, self._interrupted = Lock(), Event()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._interrupted.set()
        self.pool.shutdown(wait=False, cancel_futures=True)
        with self._lock:
            for worker in self._workers:
                worker.end()
        self.pool.shutdown()
        for worker in self._workers:  # no thread has one any more
            worker.close()

    def result(self, cell: ReplayRequest, forecast: _Forecast) -> CellResult:
        """Replay a cell, unless it is there; whatever goes wrong is its own failure."""
        try:
            return self._replay(cell, forecast)
        except FbenchError as error:
            return CellResult(cell, "failed", str(error))
        except OSError as error:
            return CellResult(cell, "failed", f"{folder_of(cell)}: can't be made ({error.strerror or error})")
        except Exception as error:  # noqa: BLE001  # one cell mustn't stop the rest
            return CellResult(cell, "failed", one_line(error))

    def _replay(self, cell: ReplayRequest, forecast: _Forecast) -> CellResult:
        if forecast.error is not None:
            return CellResult(cell, "failed", forecast.error)
        key = forecast.key
        if key is not None and is_sealed_run(folder_of(cell), key):
            return CellResult(cell, "there")
        folder = folder_of(cell)
        if (folder / RUN_SEAL).exists():  # damaged, or of other content
            shutil.rmtree(folder)
        with self._lock:
            if not self._idle:
                self._idle.append(Worker(self._module))
                self._workers.append(self._idle[0])
            worker = self._idle.pop()
        try:
            if self._interrupted.is_set():
                return CellResult(cell, "failed", "interrupted")
            response = worker.replay(cell)
        finally:
            with self._lock:
                self._idle.append(worker)
        if response.error is not None:
            with Draft(folder):  # removes what a killed worker left
                return CellResult(cell, "unfit" if response.unfit else "failed", response.error)
        if key is not None and forecast.content is not None:
            seal_run(folder, key, forecast.content)
        return CellResult(cell, "replayed")


def _check(result: CellResult, forecast: _Forecast) -> CellResult:
    """Fail a run that isn't as it was replayed any more."""
    key = forecast.key
    if not result.has_run or key is None or is_sealed_run(result.folder, key):
        return result
    return CellResult(result.cell, "failed", f"{result.folder} was changed meanwhile; the same command redoes it")
