"""`fbench demo`: simulate drives through the city, replay each into every pipeline, and write tables and a report."""

import json
import os
import re
import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from typer import Option

from fbench.cli import options
from fbench.cli.progress import import_progress, replay_progress
from fbench.cli.show import say, show_summary
from fbench.replay.contracts.errors import EXIT_LOSSY, EXIT_OK, ConfigError, output_error
from fbench.replay.data.scores import format_count

if TYPE_CHECKING:
    from fbench.api.suites.logs import Drive
    from fbench.api.suites.suite import SuitePipeline
    from fbench.cli.experiment import Done, Experiment
    from fbench.datasets.city.request import Split
    from fbench.replay.contracts.devices import Device
    from fbench.replay.data.scores import Results


def demo(
    out: Annotated[Path, Option("--out", "-o", help="Folder for logs, runs, tables and the report.")] = Path(
        "runs/demo"
    ),
    split: Annotated[
        Literal["dev", "test"] | None,
        Option(help="Run the full suite, with seeds to develop on (dev) or to report (test)."),
    ] = None,
    seconds: Annotated[
        float | None, Option(metavar="S", help="Length of each log, in s (default: 1 to 1.5; with --split: 10).")
    ] = None,
    num_seeds: Annotated[int | None, Option(metavar="N", min=1, help="Only the first N seeds of the split.")] = None,
    sensors: Annotated[
        list[str] | None,
        Option(
            metavar="PATTERN",
            help="Sensors to simulate (default: camera, lidar, radar; with --split: all); repeatable.",
        ),
    ] = None,
    jobs: options.Jobs = None,
    device: options.Device = "cpu",
) -> None:
    """Simulate drives through a city in clear and bad weather, replay each into many pipelines, and compare.

    Logs and runs that exist already aren't made again.
    """
    what = make_experiment(out, split, seconds, num_seeds, sensors or ())
    raise typer.Exit(run_experiment(what, jobs or len(os.sched_getaffinity(0)), device))


def make_experiment(
    out: Path, split: "Split | None", seconds: float | None, num_seeds: int | None, sensors: Sequence[str] = ()
) -> "Experiment":
    """Return what `fbench demo` is to do; without a split it is the short version. Raises ConfigError where options
    don't fit.
    """
    from fbench.api.suites.file import SuiteText
    from fbench.api.suites.plan import make_suite
    from fbench.cli.experiment import CLEAR, DISTURBED_S, NUM_DISTURBED, RENDERED, Experiment
    from fbench.datasets.city.request import SEEDS
    from fbench.datasets.city.spec import CitySpec

    # Where it puts the results and with how many processes changes nothing.
    command = "fbench demo" if split is None else f"fbench demo --split {split}"
    command += "" if seconds is None else f" --seconds {seconds!r}".removesuffix(".0")
    command += "" if num_seeds is None else f" --num-seeds {num_seeds}"
    command += "".join(f" --sensors {shlex.quote(pattern)}" for pattern in sensors)
    if split is None and num_seeds is not None:
        raise ConfigError("--num-seeds is only for the full suite; add --split dev or test")
    name = "demo.toml" if split is None else "experiment.toml"
    content = (files("fbench.cli") / name).read_text(encoding="utf-8")
    if seconds is not None:
        CitySpec(seconds=seconds)  # so that the error names the option
        content = re.sub(r"(?m)^seconds = .*$", f"seconds = {seconds!r}", content)
    if split is not None:
        content = re.sub(r"(?m)^seed = .*$", f"seed = {list(SEEDS[split][:num_seeds])}", content)
    if sensors:
        content = re.sub(r"(?m)^sensors = .*$", lambda _: f"sensors = {json.dumps(list(sensors))}", content)
    absent = _absent(sensors)
    if "camera" in absent:
        content = re.sub(r"(?m)^cameras = .*$", "cameras = []", content)
    suite = make_suite(SuiteText(content.encode(), name), Path(), out)
    rows = tuple(_fit(row, absent) for row in suite.pipelines if not set(row.sensors) or set(row.sensors) - absent)
    left_out = [f"{row.name} (the drives are without {', '.join(row.sensors)}, see --sensors)"
                for row in suite.pipelines if row.sensors and not set(row.sensors) - absent]  # fmt: skip
    drives = sorted((log.drive for log in suite.logs if log.drive is not None), key=lambda drive: drive.spec.seed)
    if split is None:
        drives = [log.drive for log in suite.logs if log.drive is not None]
        drives[0] = replace(drives[0], log=out / "city.mcap")  # the one that people go on with
    disturbed: tuple[Drive, ...] = ()
    rendered: tuple[Drive, ...] = ()
    if split is not None and drives[0].spec.seconds < DISTURBED_S:
        left_out.append(f"other disturbances (they need drives of {DISTURBED_S:g} s)")
    elif split is not None:
        few = SEEDS[split][:num_seeds][:NUM_DISTURBED]
        disturbed = tuple(d for d in drives if d.condition == CLEAR and d.spec.seed in few)
        rendered = tuple(_in_light(drive, light, out) for light in RENDERED for drive in disturbed)
    return Experiment(
        tuple(drives), rows, out, command, content, disturbed, rendered, suite.options.scoring, tuple(left_out)
    )


def _in_light(drive: "Drive", light: str, out: Path) -> "Drive":
    """The beginning of a drive in other light."""
    from fbench.api.suites.logs import Drive
    from fbench.api.suites.suite import LOGS
    from fbench.cli.experiment import DISTURBED_S
    from fbench.datasets.city.spec import condition

    own = Drive(replace(drive.spec, condition=condition(light), seconds=DISTURBED_S), Path())
    return replace(own, log=out / LOGS / f"{own.name}.mcap")


def _absent(patterns: Sequence[str]) -> set[str]:
    """Sensors that drives lack where `--sensors` names which they have."""
    from fbench.datasets.city.rig import thesis_rig
    from fbench.replay.contracts.sensor_settings import choose_sensors, make_sensors

    names = thesis_rig().names
    return set(names) - set(choose_sensors(names, make_sensors(patterns))) if patterns else set()


def _fit(row: "SuitePipeline", absent: set[str]) -> "SuitePipeline":
    """A row without settings and sensors that the drives lack."""
    settings = tuple(text for text in row.settings if text.partition(".")[0] not in absent)
    return replace(row, settings=settings, sensors=tuple(name for name in row.sensors if name not in absent))


def run_experiment(what: "Experiment", num_jobs: int, device: "Device" = "cpu") -> int:
    """Simulate, replay and score what isn't there; print and write the results; return the exit code. Raises
    ConfigError where the folder can't be written, or the device can't be used.
    """
    from fbench.api.replays import require_device
    from fbench.api.suites.logs import simulate
    from fbench.api.suites.run import run_suite
    from fbench.api.suites.runner import RunOptions
    from fbench.cli.experiment import is_lossy, results_of
    from fbench.datasets.importing.run import claim

    require_device(device)
    try:
        what.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(what.folder, error, "; choose another with --out") from error
    try:
        # Two in one folder would clear away each other's half-written runs.
        with claim(what.folder / "demo", lambda: say("waiting for another fbench demo in this folder")):
            drives = (*what.drives, *what.rendered)
            num, num_new = len(drives), 0
            if sys.stderr.isatty():
                say(f"simulating {format_count(num, 'drive')} and replaying each into {len(what.pipelines)} pipelines")
            with import_progress(num) as progress:
                for is_new in simulate(drives, progress):
                    num_new += is_new
                    progress.done()
            say(f"logs: {num} ({num_new} simulated, {num - num_new} there already)")
            cells = what.cells()
            with replay_progress("replays") as progress_of_replays:
                found = run_suite(
                    [replace(cell.request, device=device) for cell in cells], RunOptions(num_jobs), progress_of_replays
                )
            of = {state: sum(result.state == state for result in found) for state in ("there", "replayed", "unfit")}
            total = f"{of['there'] + of['replayed']} of {len(found) - of['unfit']}"
            say(f"runs: {total} ({of['replayed']} replayed, {of['there']} there already)")
            done = list(zip(cells, found, strict=True))
            results = results_of(what, done)
            show_summary(results)
            say(*(f"{path.stem}: {path}" for path in _write(what, results, done)))
            return EXIT_LOSSY if is_lossy(done) else EXIT_OK
    except KeyboardInterrupt:
        sys.stderr.write("fbench: interrupted; finished work is kept, and the same command continues from there\n")
        raise


def _write(what: "Experiment", results: "Results", done: "Done") -> list[Path]:
    """Write the results in every form, and return the paths worth naming."""
    from fbench.api.suites.bench import SUITE
    from fbench.api.suites.tables import write_tables
    from fbench.cli.experiment import runs_to_show
    from fbench.replay.data.files import replace_text
    from fbench.replay.data.scores import ScoreOptions, table_rows
    from fbench.replay.runs.folder import Run
    from fbench.reports.html.page import HtmlReport
    from fbench.reports.markdown import markdown, markdown_of_times

    folder = what.folder
    runs = [
        {"scene": cell.drive.scene, "condition": cell.drive.condition, "disturbance": cell.disturbance,
         "pipeline": cell.name, "log_id": cell.drive.spec.log_id, "run": result.folder.relative_to(folder).as_posix(),
         "digest": Run(result.folder).manifest.digest if result.has_run else None, "reason": result.reason}
        for cell, result in done
    ]  # fmt: skip
    tables = {table.name: table_rows(table) for table in results.tables}
    content = {"facts": dict(results.facts), "tables": tables, "problems": list(results.problems), "runs": runs}
    measured = {table.name: table_rows(table) for table in results.measured}
    for name, values in (("results", content), ("latency", measured)):
        replace_text(folder / f"{name}.json", json.dumps(values, indent=1, allow_nan=False) + "\n")
    replace_text(folder / "results.md", markdown(results))
    replace_text(folder / "latency.md", markdown_of_times(results))
    if what.content:
        replace_text(folder / SUITE, what.content)
    write_tables(folder, what.name_cells(done), done[0][1].cell.scoring if done else ScoreOptions())
    if not (shown := runs_to_show(done)):
        return [folder / "results.md"]
    HtmlReport().write_results(results, shown, folder / "report.html")
    return [folder / "results.md", folder / "report.html"]
