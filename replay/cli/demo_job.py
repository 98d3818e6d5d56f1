"""The demo: a log that needs no download, three pipelines, one report."""

from pathlib import Path

from fbench.replay.cli.import_report import log_line
from fbench.replay.cli.job import Job, run_job
from fbench.replay.cli.progress import import_progress
from fbench.replay.cli.run_summary import show_run
from fbench.replay.cli.show import console
from fbench.replay.config.source import LogSource
from fbench.replay.fault_budget import FaultBudget
from fbench.replay.imports.run import holds_log, write_recording
from fbench.replay.logs.convert.target import Target
from fbench.replay.plugins import load

PIPELINES = ("lidar3d", "radar3d", "late3d")


def run_demo(folder: Path) -> None:
    """Simulate, replay, score, report; replaces the last demo, apart from its log, which is the same each time."""
    folder.mkdir(parents=True, exist_ok=True)
    log = folder / "city.mcap"
    _simulate(log)
    out = console()
    runs = []
    for pipeline in PIPELINES:
        out.print(f"\n{pipeline}", style="bold")
        job = Job(LogSource(log), pipeline, out=folder / pipeline, overwrite=True, budget=FaultBudget(None))
        runs.append(run_job(job))
        show_run(runs[-1], as_json=False)
    report = folder / "report.html"
    load("reports", "html")().write(runs, report)
    out.print(f"\nreport: {report}", markup=False, soft_wrap=True)


def _simulate(log: Path) -> None:
    from fbench.datasets.city.recording import CityRecording
    from fbench.datasets.city.suite import demo_spec

    spec = demo_spec()
    is_there = holds_log(log, spec.log_id)
    if not is_there:
        console().print(
            f"simulating a drive of {spec.seconds:g} s with all sensors; takes a minute or two", markup=False
        )
    with import_progress(1) as progress:
        done = write_recording(CityRecording(spec, log.stem), Target(log, overwrite=not is_there), progress)
    for line in (*done.lines, f"log: {log_line(done)}"):
        console().print(line, markup=False, soft_wrap=True)
