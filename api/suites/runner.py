"""One cell of a suite: how its run is found, fetched, or replayed, and what cells have in common."""

import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Lock

from fbench.api.suites.cells import RUN_SEAL, CellResult, Response, folder_of, is_sealed_run, seal_run
from fbench.api.suites.contents import Content, Contents, key_of
from fbench.api.suites.process import WORKER
from fbench.api.suites.store import ResultStore, fetch_log
from fbench.replay.contracts.errors import ConfigError, FbenchError, one_line
from fbench.replay.data.files import Draft
from fbench.replay.setup.request import ReplayRequest

_MOST_SHARED = 1 << 30  # Bytes of messages that one process keeps for its next cells
_SHARE_OF_MEMORY = 8  # All processes together keep that part of the memory at most


@dataclass(frozen=True)
class RunOptions:
    """How a suite is run; nothing of it changes a result."""

    jobs: int = 1
    """Processes at a time, each on one thread; on a cluster, its workers decide."""
    scheduler: str = ""
    """Address of a Dask scheduler, such as `tcp://10.0.0.1:8786`; empty: processes on this machine."""
    store: str = ""
    """Folder or URL in which run folders are kept by their keys; empty: none."""
    urls: Mapping[str, str] = field(default_factory=dict)
    """Where logs come from that may not be on this machine yet, by their absolute paths."""
    module: str = WORKER
    """What a process runs."""

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise ConfigError(f"--jobs {self.jobs}: expected at least 1")


class CellRunner:
    """Gives cells their runs: finds, fetches or replays them. Used by several threads at a time."""

    def __init__(self, options: RunOptions) -> None:
        self._options, self._contents = options, Contents()
        self._store = ResultStore(options.store) if options.store else None
        self._lock, self._fetched = Lock(), dict[str, Path]()

    def run(self, cell: ReplayRequest, worker: Callable[[ReplayRequest], Response]) -> CellResult:
        """Return what became of a cell, which `worker` replays unless it is there; whatever goes wrong is its own
        failure.
        """
        try:
            return self._run(cell, worker)
        except FbenchError as error:
            return CellResult(cell, "failed", str(error))
        except OSError as error:
            return CellResult(cell, "failed", f"{folder_of(cell)}: can't be made ({error.strerror or error})")
        except Exception as error:  # noqa: BLE001  # one cell, or its plug-in, mustn't stop the rest
            return CellResult(cell, "failed", one_line(error))

    def _run(self, cell: ReplayRequest, worker: Callable[[ReplayRequest], Response]) -> CellResult:
        folder, here = folder_of(cell), self._localize(cell)
        with self._lock:
            content = self._contents.of(here)
        key = None if content is None else key_of(content)
        if key is not None and is_sealed_run(folder, key):
            return CellResult(cell, "there", key=key)
        if (folder / RUN_SEAL).exists():  # damaged, or of other content
            shutil.rmtree(folder)
        if key is not None and self._store is not None and self._store.fetch(key, folder):
            return CellResult(cell, "there", key=key)
        response = worker(here)
        if response.error is not None:
            with Draft(folder):  # removes what a killed worker left
                return CellResult(cell, "unfit" if response.unfit else "failed", response.error)
        if key is not None and content is not None:
            self._keep(folder, key, content)
        return CellResult(cell, "replayed", key=key)

    def _keep(self, folder: Path, key: str, content: Content) -> None:
        seal_run(folder, key, content)
        if self._store is not None:
            self._store.put(key, folder)

    def _localize(self, cell: ReplayRequest) -> ReplayRequest:
        """Fetch the log where it isn't here."""
        if (url := self._options.urls.get(str(cell.log.path.absolute()))) is None:
            return cell
        with self._lock:
            if url not in self._fetched:
                self._fetched[url] = fetch_log(url, cell.log.path)
        return replace(cell, log=replace(cell.log, path=self._fetched[url]))


def share_memory(jobs: int) -> int:
    """Return how much memory each of some processes may take for messages that its next cells need, too."""
    whole = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return min(_MOST_SHARED, whole // _SHARE_OF_MEMORY // jobs)


def group_of(cell: ReplayRequest) -> str:
    """Return what cells have in common that need the same messages."""
    return repr((cell.log, cell.condition, cell.seed if cell.condition else 0))
