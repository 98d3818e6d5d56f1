"""The page, put together from templates, style, scripts and data, and written.

Curves are drawn by uPlot (51 kB, in `vendor`), all else by plain JavaScript: plotly's bundle alone weighs 4.5 MB, and
the frame viewer (points, boxes and image linked to each other) would have to be written by hand anyway.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup

from fbench.replay.contracts.errors import ConfigError, output_error
from fbench.replay.data.comparison import Comparison
from fbench.replay.data.files import Draft
from fbench.replay.data.scores import Results
from fbench.replay.runs.folder import Run
from fbench.reports.html import latency, overview
from fbench.reports.html.details import details_of
from fbench.reports.html.records import PACKAGE, environment, island, read_script, read_style
from fbench.reports.html.results import result_view
from fbench.reports.html.scene import BUDGET_MB, PLAYER, scenes
from fbench.reports.html.scoreboard import OF_SLICES, PRIMARY, scoreboard

_SCRIPTS = ("vendor/uplot.js", "base.js", *PLAYER, "charts.js", "details.js")
_PAGE_BYTES = 500_000  # About what scripts, style and tables take
COMPARISON = "comparison.html"
"""Name under which the report of a suite links to a comparison beside it."""
_STYLES = ("vendor/uplot.css", "style.css", "summary.css")


@dataclass(frozen=True)
class Verdict:
    """A comparison of the run with a baseline."""

    base: str  # Its name
    comparison: Comparison

    @property
    def level(self) -> str:
        """How it looks."""
        return {"failed": "bad", "inconclusive": "warn"}.get(self.comparison.state, "info")


def page(
    runs: Sequence[Run],
    results: Results | None = None,
    links: Sequence[tuple[str, str]] = (),
    budget_mb: float = BUDGET_MB,
    verdict: Verdict | None = None,
) -> str:
    """Return the whole page as text, the tables of an experiment first where there are any. `links`: other pages, by
    name and relative address. The page has about `budget_mb` MB at most, unless its tables alone have more: so many
    frames are left out. `verdict`: what a comparison of the run says.
    """
    labels = overview.run_labels(runs)
    heads = [overview.overview(run, label) for run, label in zip(runs, labels, strict=True)]
    panels = latency.latency_panels(runs, labels)
    timing = []
    for run, panel in zip(runs, panels, strict=True):
        total, table = latency.frame_times(run), panel["table"]
        timed = [row for row, ms in enumerate(total) if ms is not None]
        num_warm = max(0, len(timed) - table.frames) if table else 0  # Frames that the table leaves out
        warm_up = timed[num_warm - 1] + 1 if num_warm else 0
        timing.append({"budget": table.budget_ms if table else None, "total": total, "warm_up": warm_up})
    rest = len(island(timing)) + _PAGE_BYTES + sum(len(island(overview.timeline(run))) for run in runs)
    scene = scenes(runs, labels, max(0.0, budget_mb * 1e6 - rest))
    board = scoreboard(runs, labels)
    details = details_of(runs, board["settings"], board["class_"])
    return environment(PACKAGE).get_template("report.html").render(
        title=overview.title(runs) if results is None else results.title,
        results=None if results is None else result_view(results),
        links=links,
        verdict=verdict,
        labels=labels,
        overviews=heads,
        notices=overview.notices(heads),
        board=board,
        metrics=[(metric, PRIMARY[metric]) for metric in OF_SLICES],
        commands=overview.commands(runs),
        latency=panels,
        stacks=latency.latency_stacks(runs, labels),
        has_details=any(own is not None for own in details["runs"]),
        details=Markup(island(details)),  # noqa: S704 - escaped by `island`
        conditions=overview.conditions(runs, labels),
        critical=overview.critical_errors(runs, labels),
        faults=overview.fault_lines(runs, labels),
        groups=overview.what_ran(runs),
        velocity_periods=overview.velocity_periods(runs),
        scene=scene,
        budget_mb=budget_mb,
        style=read_style(*_STYLES),
        script=read_script(*_SCRIPTS),
        data=Markup(island(scene.content)),  # noqa: S704 - escaped by `island`
        store=Markup(scene.store.text),  # noqa: S704 - base64
        timing=Markup(island(timing)),  # noqa: S704
    )  # fmt: skip


class HtmlReport:
    """One self-contained HTML file about one run, or about several side by side.

    It loads nothing, works offline, and is equal byte by byte for equal run folders; all that was measured on the
    host's clock stands inside the one section `timing`. `budget_mb` is about its size at most [MB]; a `verdict` stands
    at its top.
    """

    def __init__(self, budget_mb: float = BUDGET_MB, verdict: Verdict | None = None) -> None:
        self._budget_mb, self._verdict = budget_mb, verdict

    def write(self, runs: Sequence[Run], out: Path) -> None:
        """Write the report of `runs` to `out`, which appears only when whole. Raises ConfigError without runs, or where
        `out` can't be written. Raises RunError where a run folder is damaged.
        """
        if not runs:
            raise ConfigError("report: no runs given; name at least one run folder")
        write_whole(out, page(runs, budget_mb=self._budget_mb, verdict=self._verdict).encode("utf-8"))

    def write_results(self, results: Results, runs: Sequence[Run], out: Path) -> None:
        """Write the tables of an experiment, and below them the report of `runs`, some of its own; see `write`. Where a
        comparison stands beside it, it links to that.
        """
        links = [("Comparison", COMPARISON)] if (out.parent / COMPARISON).is_file() else []
        write_whole(out, page(runs, results, links, self._budget_mb).encode("utf-8"))


def write_whole(out: Path, content: bytes) -> None:
    """Write a file that appears only when whole. Raises ConfigError where it can't be written."""
    try:
        with Draft(out) as draft:
            draft.path.write_bytes(content)
            draft.publish()
    except OSError as error:
        raise output_error(out, error) from error
