"""Runs: open one as tables, compare them, and write reports."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from fbench.api.scores import open_folder, open_folders
from fbench.replay.contracts.entry_points import load
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.scores import format_count, score_rows
from fbench.replay.runs.folder import Run

if TYPE_CHECKING:
    import pandas as pd

    from fbench.replay.data.comparison import Comparison


@dataclass(frozen=True)
class OpenRun:
    """A run whose tables are pandas DataFrames; each is read when it is asked for."""

    run: Run

    @property
    def folder(self) -> Path:
        """The run folder."""
        return self.run.folder

    @property
    def complete(self) -> bool:
        """Whether no data was lost beyond the fault budget."""
        return self.run.manifest.complete

    def scores(self) -> "pd.DataFrame":
        """Return the scores: `metric`, `class`, `slice`, `matching`, `value`, `reason`, `unit`, `counts`."""
        import pandas as pd

        return pd.DataFrame(score_rows(self.run.scores))

    def detections(self) -> "pd.DataFrame":
        """Return the detections: a row a box with the index of its `frame`; columns as in `replay/data/boxes.py`."""
        return self._read("detections.parquet")

    def tracks(self) -> "pd.DataFrame":
        """Return the tracks, in the form of `detections`."""
        return self._read("tracks.parquet")

    def truth(self) -> "pd.DataFrame":
        """Return the 3D truth, in the form of `detections`; empty where the log has none."""
        return self._read("truth.parquet")

    def frames(self) -> "pd.DataFrame":
        """Return the frames: a row each with stamps [ns], segment, missing sensors and digests."""
        return self._read("frames.parquet")

    def latency(self) -> "pd.DataFrame":
        """Return the latency of each stage [ms], and of the whole frame in the last row."""
        import pandas as pd

        return pd.DataFrame(self.run.json("latency.json")["stages"]).set_index("stage")

    def _read(self, name: str) -> "pd.DataFrame":
        import pandas as pd

        path = self.folder / name
        return pd.read_parquet(path) if path.is_file() else pd.DataFrame()

    def _repr_html_(self) -> str:
        """Show what ran and the primary scores in a notebook."""
        manifest = self.run.manifest
        state = "" if manifest.complete else ", incomplete"
        head = f"{manifest.log.name} → {manifest.pipeline}: {format_count(manifest.num_frames, 'frame')}{state}"
        scores = self.scores()
        shown = scores[scores["slice"] == "all"] if len(scores) else scores
        columns = [name for name in ("metric", "class", "matching", "value", "unit") if name in shown]
        return f"<p><b>{escape(head)}</b><br>{escape(str(self.folder))}</p>{shown[columns].to_html(index=False)}"


@dataclass(frozen=True, eq=False)
class RunComparison:
    """Two runs or suites side by side."""

    comparison: "Comparison"

    @property
    def notes(self) -> tuple[str, ...]:
        """What else differs between the runs."""
        return self.comparison.notes

    @property
    def is_worse(self) -> bool:
        """Whether the gate fails: a number that gates became worse, or lost its value, or a budget was exceeded."""
        return self.comparison.is_worse

    def rows(self) -> "pd.DataFrame":
        """Return all metrics of both sides, a row each."""
        import pandas as pd

        return pd.DataFrame([asdict(row) for row in self.comparison.rows])

    def _repr_html_(self) -> str:
        """Show the verdict and the rows in a notebook."""
        notes = "".join(f"<li>{escape(note)}</li>" for note in self.notes)
        verdict = escape(self.comparison.headline)
        return f"<p><b>{verdict}</b></p><ul>{notes}</ul>{self.rows().to_html(index=False)}"


def open_run(folder: Path | str) -> OpenRun:
    """Open a run folder. Raises ConfigError where there is no such folder. Raises RunError where it isn't a run."""
    return OpenRun(open_folder(Path(folder)))


def compare(
    base: Path | str,
    head: Path | str,
    tolerance: float = 0.0,
    policy: Path | str | None = None,
    reference: Literal["truth", "base"] = "truth",
) -> RunComparison:
    """Compare two runs, or two suites cell by cell.

    Args:
        base: Folder of the run or suite to compare with, or a baseline file.
        head: Folder of the run or suite that should not be worse.
        tolerance: How much F1 and MOTA may fall, where there is no policy.
        policy: A `gate.toml` that says what gates.
        reference: `base`: without labels, the results of the base stand for truth.

    Raises:
        ConfigError: where a folder isn't there, or the policy isn't as expected.
        RunError: where one isn't a run.
        MetricError: where the two can't be compared, or nothing was measured.
    """
    from fbench.api.gates import CompareRequest, compare_sides

    file = None if policy is None else Path(policy)
    return RunComparison(compare_sides(CompareRequest(Path(base), Path(head), tolerance, file, reference)))


def report(
    runs: Sequence[Path | str],
    out: Path | None = None,
    kind: str = "html",
    budget_mb: float | None = None,
    base: Path | str | None = None,
) -> Path:
    """Write one self-contained report of one or several runs and return its path.

    Args:
        runs: Run folders.
        out: The file; `None`: `report.html` in the first run.
        kind: Name of the report plug-in.
        budget_mb: Size that the HTML report may have [MB], frames with errors first; `None`: 25.
        base: Run or baseline file that the only run is compared with; the HTML report begins with the verdict.

    Raises:
        ConfigError: where a folder isn't there, there is no such plug-in, the budget isn't a positive number, or what
            is given is for another kind or number of runs.
        MetricError: where the run can't be compared with the base.
    """
    if base is not None and (kind != "html" or len(runs) != 1):
        raise ConfigError("--base is for the report of kind html of one RUN, which it is compared with")
    if budget_mb is not None and kind != "html":
        raise ConfigError(f"--budget-mb is for reports of kind html, not {kind}")
    if budget_mb is not None and not 0 < budget_mb < math.inf:
        raise ConfigError(f"--budget-mb: expected a positive number of MB, got {budget_mb:g}")
    opened = open_folders(runs)
    path = out or opened[0].folder / "report.html"
    if budget_mb is None and base is None:
        load("reports", kind)().write(opened, path)
        return path
    from fbench.reports.html.page import HtmlReport, Verdict
    from fbench.reports.html.scene import BUDGET_MB

    verdict = None if base is None else Verdict(Path(base).name, compare(base, runs[0]).comparison)
    HtmlReport(BUDGET_MB if budget_mb is None else budget_mb, verdict).write(opened, path)
    return path
