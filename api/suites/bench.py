"""Suites of logs, pipelines, conditions, rates and seeds, from a file."""

import os
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from fbench.api.replays import require_device
from fbench.api.suites.cells import CELLS, SCORES, CellResult
from fbench.api.suites.logs import simulate
from fbench.api.suites.store import fetch_log, put_log
from fbench.api.suites.tables import write_tables
from fbench.datasets.importing.run import claim
from fbench.replay.contracts.devices import Device, check_device
from fbench.replay.contracts.errors import RunError, output_error
from fbench.replay.data.files import replace_text
from fbench.replay.data.scores import Results

if TYPE_CHECKING:
    import pandas as pd

    from fbench.api.suites.ablation import Ablation
    from fbench.api.suites.runner import RunOptions
    from fbench.api.suites.suite import Suite, SuiteCell

SUITE = "suite.toml"
Finished: TypeAlias = "Callable[[SuiteCell, CellResult], None]"


@dataclass(frozen=True)
class BenchRequest:
    """A suite, and how it is run."""

    suite: Path
    """The suite file."""
    out: Path | None = None
    """Folder for everything; `None`: `runs/NAME`."""
    jobs: int | None = None
    """Processes at a time; `None`: one a core."""
    scheduler: str = ""
    """Address of a Dask scheduler; empty: processes on this machine."""
    store: str = ""
    """Folder or URL that keeps run folders by their content; empty: none."""
    device: Device = "cpu"
    """What runs networks; on a cluster, its workers need it."""
    leave_one_out: bool = False
    """Also each pipeline without each of its sensors."""


@dataclass(frozen=True)
class OpenSuite:
    """A suite that was run, with its tables as pandas DataFrames."""

    folder: Path

    def cells(self) -> "pd.DataFrame":
        """Return a row a cell: log, pipeline, condition, rate, seed, state, reason, key, run."""
        return self._read(CELLS)

    def scores(self) -> "pd.DataFrame":
        """Return a row a number: its cell, then metric, class, slice, matching, value, reason, unit, counts (JSON)."""
        return self._read(SCORES)

    @property
    def complete(self) -> bool:
        """Whether no cell failed."""
        return not bool((self.cells()["state"] == "failed").any())

    def _read(self, name: str) -> "pd.DataFrame":
        import pandas as pd

        if not (path := self.folder / name).is_file():
            raise RunError(f"{path}: no such file; {self.folder} isn't the folder of a suite that ended")
        return pd.read_parquet(path)


@dataclass(frozen=True)
class BenchResult:
    """What became of all cells, and what they say."""

    suite: "Suite"
    cells: Sequence[tuple["SuiteCell", CellResult]]
    results: Results


def bench(
    request: BenchRequest,
    simulated: Callable[[str, int, int], None] = lambda name, done, total: None,
    finished: Finished = lambda cell, result: None,
    waits: Callable[[], None] = lambda: None,
) -> OpenSuite:
    """Run a suite, and return it; finished cells stay, and an interrupted suite continues.

    Args:
        request: The suite and how it is run.
        simulated: Gets the name of the log that is being simulated, and how many of its items are done, of how many.
        finished: Gets each cell with what became of it.
        waits: Is called where another process runs a suite in the same folder.

    Raises:
        ConfigError: with file, line and key of what isn't as expected; then nothing has run.
        LogError: where a log can't be simulated or read.
    """
    return OpenSuite(run_bench(request, simulated, finished, waits).suite.folder)


def run_bench(
    request: BenchRequest,
    simulated: Callable[[str, int, int], None] = lambda name, done, total: None,
    finished: Finished = lambda cell, result: None,
    waits: Callable[[], None] = lambda: None,
    watch: Callable[[Sequence["SuiteCell"]], AbstractContextManager[None]] = lambda cells: nullcontext(),
) -> BenchResult:
    """Run a suite as `bench` does, and return what became of each cell; `watch` is entered with all cells, and left
    when they are done.
    """
    from fbench.api.suites.ablation import leave_out_sensors
    from fbench.api.suites.plan import read_suite
    from fbench.api.suites.results import results_of
    from fbench.api.suites.runner import RunOptions

    suite = read_suite(request.suite, request.out)
    suite = replace(suite, options=replace(suite.options, device=request.device))
    check_device(request.device)
    if not request.scheduler:
        require_device(request.device)
    make_folder(suite.folder)
    with claim(suite.folder / "bench", waits):
        list(simulate([log.drive for log in suite.logs if log.drive is not None], simulated))
        ablations: Sequence[Ablation] = ()
        if request.leave_one_out:
            for log in suite.logs:
                if log.url:
                    fetch_log(log.url, log.request.path)
            suite, ablations = leave_out_sensors(suite)
        cells = suite.cells()
        options = RunOptions(
            request.jobs or len(os.sched_getaffinity(0)), request.scheduler, request.store,
            {**suite.urls, **_publish(suite, request)},
        )  # fmt: skip
        with watch(cells):
            results = run_cells(cells, options, finished)
        done = list(zip(cells, results, strict=True))
        replace_text(suite.folder / SUITE, suite.content)
        write_tables(suite.folder, done, suite.options.scoring, suite.profiles)
        return BenchResult(suite, done, results_of(suite, done, ablations))


def run_cells(
    cells: Sequence["SuiteCell"], options: "RunOptions", finished: "Finished" = lambda cell, result: None
) -> list[CellResult]:
    """Run cells as `run_suite` does; `finished` gets each with what became of it."""
    from fbench.api.suites.run import run_suite

    of = {id(cell.request): cell for cell in cells}
    requests = [cell.request for cell in cells]
    return run_suite(requests, options, finished=lambda result: finished(of[id(result.cell)], result))


def make_folder(folder: Path) -> None:
    """Make the folder of a suite. Raises ConfigError where it can't be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(folder, error, "; choose another with --out") from error


def _publish(suite: "Suite", request: BenchRequest) -> dict[str, str]:
    """Put simulated logs where workers without our disk find them."""
    if not (request.scheduler and request.store):
        return {}
    urls: dict[str, str] = {}
    for log in suite.logs:
        if log.drive is not None:
            url = f"{request.store.rstrip('/')}/logs/{log.drive.spec.log_id}/{log.request.path.name}"
            put_log(log.request.path, url)
            urls[str(log.request.path.absolute())] = url
    return urls
