"""Pages of comparisons, and forms of a report besides its page: an overlay, tables, figures, what localhost serves."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from fbench.api.scores import open_folder, open_folders
from fbench.api.suites.cells import CELLS
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.logs.open import open_log
from fbench.replay.runs.folder import Run
from fbench.replay.runs.redaction import public_id

if TYPE_CHECKING:
    from fbench.replay.data.comparison import Comparison


def overlay(run: Path | str, out: Path, log: Path | None = None, options: ScoreOptions | None = None) -> list[Path]:
    """Write the results of a run as MCAP with Foxglove's schemas, and a layout for Foxglove and Lichtblick.

    Args:
        run: The run folder.
        out: The MCAP file; the layout is written beside it.
        log: The log that was replayed, whose messages are copied; `None`: open the overlay together with the log.
        options: Which boxes count and match, for their colors; `None`: as in the run's scores.

    Returns:
        Paths of the overlay and the layout.

    Raises:
        ConfigError: where there is no such run, the log isn't the one that was replayed, or nothing can be written.
        LogError: where the log can't be read.
        MetricError: where an id is twice in a frame.
    """
    from fbench.metrics.runs.outcomes import outcomes_of
    from fbench.reports.overlay.file import OWN, Names, write_overlay

    opened = open_folder(Path(run))
    reader = None if log is None else open_log(log, FaultLog())
    entry = opened.manifest.log
    if reader is not None and entry.log_id not in (reader.info.log_id, public_id(reader.info)):
        raise ConfigError(f"{log}: isn't the log of {run}, which is '{entry.name}' with id {entry.log_id}")
    outcomes = outcomes_of(opened, options or _options_of(opened))
    if reader is None:
        return write_overlay(opened, outcomes, out)
    frames = reader.coordinate_frames
    return write_overlay(opened, outcomes, out, reader.container, Names(frames.body, frames.world or OWN.world))


def rerun_recording(run: Path | str, out: Path) -> Path:
    """Write a run as a Rerun recording, `.rrd`, and return its path. Raises MissingPackageError without rerun-sdk;
    ConfigError where there is no such run, or nothing can be written; RunError where the run is damaged.
    """
    from fbench.reports.rerun_recording import write_recording

    return write_recording(open_folder(Path(run)), out)


def show_in_rerun(run: Path | str) -> None:
    """Show a run in the viewer of Rerun until that is closed; raises as `rerun_recording`."""
    from fbench.reports.rerun_recording import import_rerun

    import_rerun()
    with TemporaryDirectory(prefix="fbench-") as folder:
        path = rerun_recording(run, Path(folder) / "run.rrd")
        subprocess.run([sys.executable, "-m", "rerun", str(path)], check=False)  # noqa: S603 - the installed package


def tables(runs: Sequence[Path | str], folder: Path) -> list[Path]:
    """Write every table of the report of runs, or of a suite's results, as CSV, Parquet and Markdown into a folder, and
    return the paths. Raises ConfigError where there is no such run or nothing can be written; RunError where a run is
    damaged.
    """
    from fbench.reports.tables import write_suite_tables, write_tables

    if is_suite(runs):
        return write_suite_tables(_results(runs[0]), folder)
    return write_tables(open_folders(runs), folder)


def figures(runs: Sequence[Path | str], folder: Path) -> list[Path]:
    """Draw the figures of runs, or of a suite's results, as SVG and PNG into a folder, and return the paths. Raises
    MissingPackageError without matplotlib; ConfigError where there is no such run, nothing to draw, or nothing can be
    written; RunError where a run is damaged.
    """
    from fbench.metrics.runs.detection import detection_entries
    from fbench.reports.figures import Curve, draw_runs, draw_suite

    if is_suite(runs):
        return draw_suite(_results(runs[0]), folder)
    opened = open_folders(runs)
    curves: list[Curve | None] = []
    for run in opened:
        entry = detection_entries(run, _options_of(run))[0]
        ranking = entry.counts.ranking
        curves.append(None if entry.key.reason or ranking.reason else Curve(*ranking.curve()))
    return draw_runs(opened, curves, folder)


def render(runs: Sequence[Path | str]) -> bytes:
    """Return the page of the report of runs; of a single folder that is no run, such as a suite's, the `report.html`
    that is there. Raises ConfigError where there is neither; RunError where a run is damaged.
    """
    from fbench.reports.html.page import page

    folders = [Path(run) for run in runs]
    if len(folders) == 1 and not (folders[0] / "manifest.json").exists() and (folders[0] / "report.html").is_file():
        return (folders[0] / "report.html").read_bytes()
    return page(open_folders(folders)).encode("utf-8")


def comparison(compared: "Comparison", base: Path | str, head: Path | str, out: Path) -> Path:
    """Write the page of a comparison of two runs or suites, linked with their reports where there are any, and return
    its path. Raises ConfigError where it can't be written; RunError where a run can't be read.
    """
    from fbench.api.gates import open_side
    from fbench.api.sides import pair_cells
    from fbench.metrics.comparison.relations import ORIGINAL, RELATIONS_FILE
    from fbench.reports.html.comparison import Links, write_comparison

    paths = [Path(base), Path(head)]
    if all((path / RELATIONS_FILE).is_file() for path in paths):
        paths = [path / ORIGINAL for path in paths]
    pairs, _, _ = pair_cells(*map(open_side, paths))
    runs = {str(pair.name): (pair.base.run, pair.head.run) for pair in pairs}
    pages = [path / "report.html" if (path / "report.html").is_file() else None for path in paths]
    names = Path(base).resolve().name, Path(head).resolve().name
    write_comparison(compared, runs, names, Links(*pages), out)
    return out


def is_suite(runs: Sequence[Path | str]) -> bool:
    """Tell whether the only folder is that of a suite, whose report its command wrote."""
    if len(runs) != 1:
        return False
    is_run, *others = ((Path(runs[0]) / name).is_file() for name in ("manifest.json", CELLS, "results.json"))
    return not is_run and any(others)


def _options_of(run: Run) -> ScoreOptions:
    """Options that a run was scored with, so that all its forms agree; usual ones where it has no scores."""
    from fbench.metrics.comparison.counts import options_of

    return options_of(run.scores if (run.folder / "scores.json").is_file() else ())


def _results(folder: Path | str) -> Path:
    return Path(folder) / "results.json"
