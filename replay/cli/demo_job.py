"""The demo: a log that needs no download, three pipelines, one report."""

from pathlib import Path

from fbench.replay.cli.job import Job, run_job
from fbench.replay.cli.run_summary import show_run
from fbench.replay.cli.show import console
from fbench.replay.config.source import LogSource
from fbench.replay.fault_budget import FaultBudget
from fbench.replay.plugins import load

PIPELINES = ("lidar3d", "radar3d", "late3d")


def run_demo(folder: Path) -> None:
    """Simulate, replay, score, report; replaces the last demo."""
    from fbench.datasets.boxes import write_boxes_log

    folder.mkdir(parents=True, exist_ok=True)
    out = console()
    log = folder / "boxes.mcap"
    for line in write_boxes_log(log):
        out.print(line, markup=False, soft_wrap=True)
    runs = []
    for pipeline in PIPELINES:
        out.print(f"\n{pipeline}", style="bold")
        job = Job(LogSource(log), pipeline, out=folder / pipeline, overwrite=True, budget=FaultBudget(None))
        runs.append(run_job(job))
        show_run(runs[-1], as_json=False)
    report = folder / "report.html"
    load("reports", "html")().write(runs, report)
    out.print(f"\nreport: {report}", markup=False, soft_wrap=True)
