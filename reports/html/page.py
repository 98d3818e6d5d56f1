"""Puts the page together from templates, style, scripts and data."""

from collections.abc import Sequence
from importlib.resources import files

import jinja2
from markupsafe import Markup

from fbench.replay.result_table import Results
from fbench.replay.store import Run
from fbench.reports.html.faults import fault_lines
from fbench.reports.html.latency import latency_panels
from fbench.reports.html.notices import notices
from fbench.reports.html.overview import overview, run_labels, title, what_ran
from fbench.reports.html.radar import velocity_periods
from fbench.reports.html.records import LatencyTable
from fbench.reports.html.results import result_view
from fbench.reports.html.scene import scenes, shown_frames
from fbench.reports.html.scoreboard import scoreboard
from fbench.reports.html.text import island, number, visible
from fbench.reports.html.timeline import frame_times

_SCRIPTS = ("base.js", "view.js", "scene.js", "camera.js", "objects.js", "timeline.js", "main.js")


def page(runs: Sequence[Run], results: Results | None = None) -> str:
    """Return the whole page as text, the tables of an experiment first where there are any."""
    labels = run_labels(runs)
    overviews = [overview(run, label) for run, label in zip(runs, labels, strict=True)]
    latency = latency_panels(runs, labels)
    return _environment().get_template("report.html").render(
        title=title(runs) if results is None else results.title,
        results=None if results is None else result_view(results),
        labels=labels,
        overviews=overviews,
        notices=notices(overviews),
        board=scoreboard(runs, labels),
        latency=latency,
        faults=fault_lines(runs, labels),
        groups=what_ran(runs),
        velocity_periods=velocity_periods(runs),
        num_kept=sum(len(shown_frames(run)) for run in runs),
        style=Markup(_resource("style.css")),  # noqa: S704 - part of the package, as are the scripts
        script=Markup("\n".join(_resource(name) for name in _SCRIPTS)),  # noqa: S704
        data=Markup(island(scenes(runs, labels))),  # noqa: S704 - escaped by `island`
        timing=Markup(island([_timing(run, panel.table) for run, panel in zip(runs, latency, strict=True)])),  # noqa: S704
    )  # fmt: skip


def _timing(run: Run, table: LatencyTable | None) -> dict[str, object]:
    """Return wall times [ms], the budget, and how many frames at the start the table leaves out as warm-up."""
    total = frame_times(run)
    warm_up = max(0, len(total) - table.frames) if table else 0
    return {"budget": table.budget_ms if table else None, "total": total, "warm_up": warm_up}


def _resource(name: str) -> str:
    return files("fbench.reports.html").joinpath(name).read_text(encoding="utf-8")


def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_resource),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_shown,
    )
    environment.filters["number"] = number
    return environment


def _shown(value: object) -> object:
    """Make text visible before it is escaped."""
    return visible(value) if isinstance(value, str) and not isinstance(value, Markup) else value
