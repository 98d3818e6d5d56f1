"""`fbench demo` at work: simulate, replay, tables, report."""

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from fbench.api.cells import CellResult
from fbench.api.suite import run_suite
from fbench.cli.experiment import (
    Drive,
    Experiment,
    host_line,
    is_lossy,
    own_pipelines,
    own_variants,
    results_of,
    shown_runs,
    simulate,
)
from fbench.cli.show import console, import_progress, replay_progress, show_results
from fbench.datasets.importing.run import claim
from fbench.replay.contracts.errors import EXIT_LOSSY, EXIT_OK, ConfigError
from fbench.replay.data.files import replace_text
from fbench.replay.data.scores import Results, table_rows

if TYPE_CHECKING:
    from fbench.datasets.city.request import Scene, Split

SHORT_S, FULL_S = 1.5, 10.0  # Length of each log of the short version and of the full suite


@dataclass(frozen=True)
class DemoWish:
    """What `fbench demo` was asked for."""

    out: Path
    split: "Split | None" = None  # The full suite with the seeds of this split; `None`: the short version
    seconds: float | None = None
    num_seeds: int | None = None  # Only the first of the split's seeds
    workers: int | None = None  # `None`: as many as there are processors for us

    @property
    def command(self) -> str:
        """What does the same again; where it puts it and with how many processes changes nothing."""
        words = ["fbench demo", *([] if self.split is None else [f"--split {self.split}"])]
        words += [] if self.seconds is None else [f"--seconds {self.seconds!r}".removesuffix(".0")]
        return " ".join([*words, *([] if self.num_seeds is None else [f"--num-seeds {self.num_seeds}"])])


def run_demo(wish: DemoWish) -> int:
    """Do it, and return the exit code. Raises ConfigError where options don't fit, or the folder can't be written."""
    return run_experiment(experiment(wish), wish.workers or len(os.sched_getaffinity(0)))


def experiment(wish: DemoWish) -> Experiment:
    """Return what is to be done. Raises ConfigError where options don't fit."""
    from fbench.datasets.city.request import experiment_spec

    usual = SHORT_S if wish.split is None else FULL_S
    seconds = usual if wish.seconds is None else wish.seconds
    logs = wish.out / "logs"
    drives = [Drive(spec, logs) for spec in (experiment_spec(*one, seconds) for one in _scenes(wish))]
    drives = [replace(drive, log=logs / f"{drive.name}.mcap") for drive in drives]
    if wish.split is None:
        # The one that people go on with.
        drives[0] = replace(drives[0], log=wish.out / "city.mcap")
    pipelines = own_pipelines() if wish.split is None else (*own_pipelines(), *own_variants())
    return Experiment(tuple(drives), pipelines, wish.out, wish.command)


def run_experiment(what: Experiment, num_workers: int) -> int:
    """Simulate, replay and score what isn't there; print and write the results; return the exit code. Raises
    ConfigError where the folder can't be written.
    """
    _make_folder(what.folder)
    # Two in one folder would clear away each other's half-written runs.
    with _resumable(), claim(what.folder / "demo", _say_waiting):
        _simulate(what)
        return _finish(what, _replay(what, num_workers))


def _say_waiting() -> None:
    console().print("waiting for another fbench demo in this folder", markup=False)


def _finish(what: Experiment, done: list[tuple[Drive, CellResult]]) -> int:
    """Print and write what came out; return the exit code."""
    out = console()
    results = results_of(what, done)
    results = replace(results, measured=tuple(replace(t, notes=(host_line(),)) for t in results.measured))
    show_results(results, out)
    for path in _write(what, results, done):
        out.print(f"{path.stem}: {path}", markup=False, soft_wrap=True)
    return EXIT_LOSSY if is_lossy(done) else EXIT_OK


def _scenes(wish: DemoWish) -> "list[tuple[Scene, int]]":
    from fbench.datasets.city.request import DEMO, EXPERIMENT, SEEDS

    if wish.split is None:
        if wish.num_seeds is not None:
            raise ConfigError("--num-seeds: of the full suite only; add --split dev or test")
        return list(DEMO)
    return [(scene, seed) for seed in SEEDS[wish.split][: wish.num_seeds] for scene in EXPERIMENT]


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: can't be written ({error.strerror}); choose another with --out") from error


def _simulate(what: Experiment) -> None:
    num = len(what.drives)
    out = console()
    if sys.stderr.isatty():
        out.print(f"simulating {num} drives and replaying each into {len(what.pipelines)} pipelines", markup=False)
    num_new = 0
    with import_progress(num) as progress:
        for is_new in simulate(what.drives, progress):
            num_new += is_new
            progress.done()
    out.print(f"logs: {num} ({num_new} simulated, {num - num_new} there already)", markup=False)


def _replay(what: Experiment, num_workers: int) -> list[tuple[Drive, CellResult]]:
    cells = what.cells()
    with replay_progress("replays") as progress:
        found = run_suite([cell for _, cell in cells], num_workers, progress)
    done = [(drive, result) for (drive, _), result in zip(cells, found, strict=True)]
    num_there = sum(result.state == "there" for result in found)
    num_new = sum(result.state == "replayed" for result in found)
    num_fit = sum(result.state != "unfit" for result in found)
    line = f"runs: {num_there + num_new} of {num_fit} ({num_new} replayed, {num_there} there already)"
    console().print(line, markup=False)
    return done


@contextmanager
def _resumable() -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        sys.stderr.write("fbench: interrupted; what is finished stays, and the same command goes on from there\n")
        raise


def _write(what: Experiment, results: Results, done: list[tuple[Drive, CellResult]]) -> list[Path]:
    """Write the results in every form, and return the paths worth naming."""
    from fbench.reports.html.page import HtmlReport
    from fbench.reports.markdown import markdown

    folder = what.folder
    replace_text(folder / "results.json", _json(what, results, done))
    measured = {table.name: table_rows(table) for table in results.measured}
    replace_text(folder / "latency.json", json.dumps(measured, indent=1, allow_nan=False) + "\n")
    replace_text(folder / "results.md", markdown(results))
    written = [folder / "results.md"]
    runs = shown_runs(done)
    if runs:
        HtmlReport().write_results(results, runs, folder / "report.html")
        written.append(folder / "report.html")
    return written


def _json(what: Experiment, results: Results, done: list[tuple[Drive, CellResult]]) -> str:
    runs = [
        {"scene": drive.scene, "condition": drive.condition, "pipeline": result.cell.pipeline,
         "log_id": drive.spec.log_id, "run": result.folder.relative_to(what.folder).as_posix(),
         "digest": _digest(result), "reason": result.reason}
        for drive, result in done
    ]  # fmt: skip
    content = {
        "facts": dict(results.facts),
        "tables": {table.name: table_rows(table) for table in results.tables},
        "problems": list(results.problems),
        "runs": runs,
    }
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def _digest(result: CellResult) -> str | None:
    from fbench.replay.runs.folder import Run

    return Run(result.folder).manifest.digest if result.has_run else None
