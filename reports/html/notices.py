"""What must be known before the numbers are read: lost data, failures, missing truth."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from fbench.reports.html.overview import Overview
from fbench.reports.html.records import FaultRow


@dataclass(frozen=True)
class Notice:
    """One banner."""

    level: str
    """`bad`, `warn` or `info`."""
    head: str
    text: str
    losses: Sequence[FaultRow] = ()
    who: Sequence[str] = ()
    """Labels of the runs it is about."""


def notices(overviews: Sequence[Overview]) -> list[Notice]:
    """Return all banners, the worst first; runs about which the same must be said share one."""
    merged: dict[tuple[str, str, str, tuple[str, ...]], Notice] = {}
    for overview in overviews:
        for notice in _of(overview):
            key = (notice.level, notice.head, notice.text, tuple(row.model_dump_json() for row in notice.losses))
            before = merged.get(key, notice)
            merged[key] = replace(notice, who=(*before.who, overview.label))
    found = [*merged.values(), *_different(overviews)]
    return sorted(found, key=lambda notice: ("bad", "warn", "info").index(notice.level))


def _of(o: Overview) -> Iterator[Notice]:
    faults = "" if o.lost is None else f"{o.lost} {'fault' if o.lost == 1 else 'faults'}"
    if not o.complete:
        text = "The run is not complete; its numbers describe only what was left."
        yield Notice("bad", f"Data was lost: {faults}." if faults else "Data was lost.", text, o.losses)
    elif o.lost:
        yield Notice("warn", f"Data was lost, and tolerated: {faults}.", "The run was allowed to go on.", o.losses)
    if o.failed:
        head = f"The pipeline failed on {o.failed} of {o.frames} frames."
        yield Notice("warn", head, "Truth in these frames counts as missed.")
    if not o.labelled:
        text = "The log has no ground truth, so accuracy can’t be scored; latency, faults and outputs are all there is."
        yield Notice("info", "No truth.", text)
    elif o.labelled < o.frames:
        head = f"{o.labelled} of {o.frames} frames have truth."
        yield Notice("info", head, "The others were replayed and not scored.")
    if o.predictions is not None:
        yield Notice("info", "Tracks predicted in between stand for detections.", f"They are {o.predictions}.")


def _different(overviews: Sequence[Overview]) -> list[Notice]:
    if len({o.log_digest for o in overviews}) < 2:
        return []
    text = "Their log digests differ, so their numbers don’t compare pipelines alone."
    return [Notice("warn", "These runs replayed different data.", text)]
