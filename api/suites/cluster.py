"""Suites on many machines, by a Dask scheduler: its retries, and its care for workers that are lost.

Whoever may speak to a Dask scheduler may run any code on its workers: it belongs into a network of one's own, or behind
TLS. fbench sends cells as JSON, and gets results as JSON.
"""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import Any, Self

from fbench.api.suites.cells import RUN_SEAL, CellResult, State, folder_of
from fbench.api.suites.contents import digest_code
from fbench.api.suites.process import Worker
from fbench.api.suites.runner import CellRunner, RunOptions, group_of, share_memory
from fbench.api.suites.store import ResultStore
from fbench.replay.contracts.entry_points import absolute_name
from fbench.replay.contracts.errors import ConfigError, FbenchError, MissingPackageError, OutputError, one_line
from fbench.replay.contracts.variants import SUFFIX
from fbench.replay.runs.secrets import without_secrets
from fbench.replay.setup.request import ReplayRequest

try:
    import distributed
    from distributed import WorkerPlugin
except ImportError as error:
    raise MissingPackageError("--scheduler needs Dask; pip install 'fbench[cluster]'") from error

_NAME = "fbench-cells"
_TASKS_PER_THREAD = 4  # At least, so that all end at about the same time
_RETRIES = 2
_CONNECT_S = 20


class CellPlugin(WorkerPlugin):  # type: ignore[misc]  # distributed isn't looked at
    """Replays cells on a worker of Dask: each thread of that has a process, so that a crash costs only a cell."""

    name = _NAME

    def __init__(self, options: RunOptions, code: str) -> None:
        self._options, self._code = options, code

    def setup(self, worker: Any) -> None:
        """Get ready, when the worker starts or first meets this suite."""
        self._lock = Lock()
        self._runner = CellRunner(self._options)
        self._share = share_memory(max(1, worker.state.nthreads))
        self._idle: list[Worker] = []
        self._where = f"{worker.name} on {worker.address}"

    def teardown(self, worker: Any) -> None:
        """End all processes."""
        for process in self._idle:
            process.close()

    def run(self, text: str) -> dict[str, str | None]:
        """Replay a cell, and say what became of it."""
        if digest_code() != self._code:
            what = "has another fbench, other packages or another Python than this machine; install the same"
            return {"state": "failed", "reason": f"worker {self._where} {what}", "key": None}
        cell = ReplayRequest.from_json(text)
        with self._lock:
            process = self._idle.pop() if self._idle else Worker(self._options.module, self._share)
        try:
            if not self._options.store:
                result = self._runner.run(cell, process.replay)
            else:
                with tempfile.TemporaryDirectory(prefix="fbench-") as folder:
                    own = replace(cell, out=Path(folder) / folder_of(cell).name)
                    result = self._runner.run(own, process.replay)
        finally:
            with self._lock:
                self._idle.append(process)
        return {"state": result.state, "reason": result.reason, "key": result.key}


def _run_cells(texts: list[str]) -> list[dict[str, str | None]]:
    plugin: CellPlugin = distributed.get_worker().plugins[_NAME]
    return [plugin.run(text) for text in texts]


class DaskScheduler:
    """A Dask scheduler that others started, with its workers. Raises ConfigError where it can't be reached."""

    def __init__(self, options: RunOptions) -> None:
        self._options, self._shown = options, without_secrets(options.scheduler)
        self._store = ResultStore(options.store) if options.store else None
        try:
            self._client = distributed.Client(options.scheduler, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise ConfigError(f"--scheduler {self._shown}: can't be reached ({one_line(error)})") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._client.close()  # and the scheduler forgets what we wanted

    def results(self, cells: Sequence[ReplayRequest]) -> Iterator[tuple[int, CellResult]]:
        """Yield the results as they come. Raises OutputError where the scheduler is lost."""
        self._client.register_plugin(CellPlugin(self._options, digest_code()))
        threads = sum(self._client.nthreads().values())
        groups: dict[str, list[int]] = {}
        for index, cell in enumerate(cells):
            groups.setdefault(group_of(cell), []).append(index)
        most = max(1, len(cells) // max(1, threads * _TASKS_PER_THREAD))
        tasks = [group[at : at + most] for group in groups.values() for at in range(0, len(group), most)]
        texts = [_absolute(cell).to_json() for cell in cells]
        futures = {
            self._client.submit(_run_cells, [texts[index] for index in task], pure=False, retries=_RETRIES): task
            for task in tasks
        }
        with self._client.as_current():
            done = distributed.as_completed(futures)
        for future in done:
            task = futures.pop(future)
            if future.status == "finished":
                yield from ((i, self._receive(cells[i], own)) for i, own in zip(task, future.result(), strict=True))
            elif future.status == "error":
                why = f"its worker can't replay it: {one_line(future.exception())}"
                yield from ((index, CellResult(cells[index], "failed", why)) for index in task)
            else:
                what = "finished cells are kept, and the same command continues from there"
                raise OutputError(f"--scheduler {self._shown}: was lost; {what}")
            future.release()

    def _receive(self, cell: ReplayRequest, found: dict[str, Any]) -> CellResult:
        """Check that a run is where this machine sees it, or fetch it."""
        state: State = found["state"]
        result, folder = CellResult(cell, state, found["reason"], found["key"]), folder_of(cell)
        if not result.has_run:
            return result
        try:
            if self._store is not None:
                if result.key is None:
                    return replace(result, state="failed", reason="a program's run has no key to find it by in a store")
                if not self._store.fetch(result.key, folder):
                    return replace(result, state="failed", reason="its run isn't in the store, or is damaged")
            elif not ((folder / RUN_SEAL) if result.key else folder).exists():
                why = f"its worker wrote {folder} on a disk that this machine doesn't see; use --store"
                return replace(result, state="failed", reason=why)
        except FbenchError as error:
            return replace(result, state="failed", reason=str(error))
        return result


def _absolute(cell: ReplayRequest) -> ReplayRequest:
    pipeline = str(Path(cell.pipeline).resolve()) if cell.pipeline.endswith(SUFFIX) else absolute_name(cell.pipeline)
    return replace(cell.absolute(), pipeline=pipeline)
