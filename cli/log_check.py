"""Output of `fbench log check`."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from fbench.api.runs import short_name
from fbench.cli.show import console, message_progress, print_json
from fbench.replay.check.findings import Finding, require_codes
from fbench.replay.check.log_check import CheckOptions, CheckResult, check_log
from fbench.replay.check.times import StreamStats
from fbench.replay.contracts.errors import EXIT_NO, EXIT_OK
from fbench.replay.contracts.faults import FaultLog, explain_losses
from fbench.replay.contracts.plugins import give_log, opened_pipeline
from fbench.replay.contracts.protocols import Pipeline
from fbench.replay.setup.request import ReplayRequest


@dataclass(frozen=True)
class CheckRequest:
    """Everything that `fbench log check` is asked for."""

    replay: ReplayRequest
    """The log, how its messages become frames, and the pipeline to try, if any."""
    ignored: Sequence[str] = ()
    """Codes of findings that count as information only."""
    decode_images: bool = False


def run_check(request: CheckRequest, as_json: bool) -> int:
    """Check a log and print what was found; returns the exit code."""
    require_codes(request.ignored)
    faults, options = FaultLog(), request.replay.resolve()
    # What a plug-in prints must not get between the lines of --json.
    with redirect_stdout(sys.stderr), _tried(request.replay) as pipeline, explain_losses(faults):
        reader = options.log.open(faults)
        if pipeline is not None:
            give_log(pipeline[1], pipeline[0], lambda: options.log.open(faults))
        total = sum(reader.container.counts.values())
        with message_progress(f"{options.log.path.name}: reading all", total) as progress:
            check = CheckOptions(
                options.sync, options.stamps, request.decode_images, pipeline, options.sensors, tuple(request.ignored),
                progress,
            )  # fmt: skip
            result = check_log(reader, faults, check)
    if as_json:
        print_json(_content(result))
    else:
        _print(options.log.path, result)
    return EXIT_NO if result.num_problems else EXIT_OK


@contextmanager
def _tried(request: ReplayRequest) -> Iterator[tuple[str, Pipeline] | None]:
    """Give the pipeline to be tried and its name, if there is one."""
    if not request.pipeline:
        yield None
        return
    with opened_pipeline(request.pipeline, list(request.settings)) as (pipeline, _):
        yield short_name(request.pipeline), pipeline


def _content(result: CheckResult) -> dict[str, object]:
    return {
        "name": result.info.name,
        "log_id": result.info.log_id,
        "clean": result.num_problems == 0,
        "findings": [asdict(f) for f in result.findings],
        "storage": asdict(result.storage),
        "reference": result.reference,
        "streams": [asdict(s) for s in result.streams],
        "frames": None if result.frames is None else asdict(result.frames),
        "truth": {"messages": result.num_truths, "frames": result.num_labelled},
        "topics": [asdict(t) for t in result.topics],
    }


def _print(log: Path, result: CheckResult) -> None:
    out = console()
    out.print(f"{log}: {_summary(result)}", markup=False, soft_wrap=True)
    out.print(_streams(result))
    for f in result.findings:
        _print_finding(out, f)
    num = result.num_problems
    out.print("clean" if num == 0 else f"{num} {'finding' if num == 1 else 'findings'}", markup=False)


def _summary(result: CheckResult) -> str:
    frames = result.frames
    if frames is None:
        return "no frames"
    segments = f"{len(frames.breaks) + 1} {'segments' if frames.breaks else 'segment'}"
    complete = f"{frames.num_frames} frames by {result.reference}, {frames.num_complete} complete"
    return f"{complete}, {segments}, {result.num_labelled} with truth"


def _print_finding(out: Console, found: Finding) -> None:
    source = f" {found.source}" if found.source else ""
    first = f" (first: {found.first})" if found.first else ""
    out.print(f"{found.severity} {found.code}{source}: {found.text}{first}", markup=False, soft_wrap=True)
    if found.severity != "info":
        out.print(f"    → {found.advice}", markup=False, soft_wrap=True)


def _streams(result: CheckResult) -> Table:
    table = Table(box=None, pad_edge=False)
    for column in ("sensor", "kind", "messages", "Hz", "period ms", "longest", "jitter p99", "arrival after stamp ms"):
        table.add_column(column, justify="left" if column in ("sensor", "kind") else "right")
    for s in result.streams:
        table.add_row(
            s.sensor, s.kind, str(s.num_messages), "–" if s.rate_hz is None else f"{s.rate_hz:.1f}",
            _ms(s.median_period_ns), _ms(s.max_gap_ns), _ms(s.jitter_p99_ns), _skew(s),
        )  # fmt: skip
    return table


def _ms(value_ns: int | None) -> str:
    return "–" if value_ns is None else f"{value_ns / 1e6:.1f}"


def _skew(s: StreamStats) -> str:
    if s.skew_median_ns is None:
        return "–"
    return f"{_ms(s.skew_median_ns)} ({_ms(s.skew_min_ns)} to {_ms(s.skew_max_ns)})"
