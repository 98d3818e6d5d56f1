"""`fbench log check`."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from fbench.cli import options
from fbench.cli.progress import message_progress
from fbench.cli.show import console, make_table, plugin_output, print_json, say
from fbench.replay.contracts.errors import EXIT_NO, EXIT_OK
from fbench.replay.data.scores import format_count

if TYPE_CHECKING:
    from fbench.replay.check.log_check import CheckResult


def check(
    log: options.Log,
    pipeline: Annotated[
        str | None, Option("--pipeline", "-p", metavar="NAME", help="Also report what this pipeline would miss.")
    ] = None,
    settings: options.Settings = None,
    config: options.Config = None,
    rig: options.RigFiles = None,
    decoder: options.Decoders = None,
    truth: options.TruthFile = None,
    truth_format: options.TruthFormat = None,
    truth_frame: options.TruthFrame = "",
    reference: options.Reference = None,
    timeout_ms: options.TimeoutMs = None,
    tolerance_ms: options.ToleranceMs = None,
    max_gap_s: options.MaxGapS = None,
    topics: options.Topics = None,
    sensors: options.Sensors = None,
    offset: options.Offset = None,
    stamps: options.Stamps = None,
    ignore: Annotated[
        list[str] | None, Option(metavar="CODE", help="Report findings of this code as information only; repeatable.")
    ] = None,
    images: Annotated[bool, Option("--images", help="Decode whole images, not only their headers.")] = False,
    isolate: options.Isolate = False,
    frame_timeout_s: options.FrameTimeoutS = 10.0,
    json: options.Json = False,
) -> None:
    """Read a whole log and report what is wrong: exit 0 clean, 1 findings, 3 unreadable."""
    from contextlib import nullcontext

    from fbench.api.replays import open_requested, short_name
    from fbench.replay.check.findings import require_codes
    from fbench.replay.check.log_check import CheckOptions, check_log
    from fbench.replay.contracts.faults import FaultLog, explain_losses
    from fbench.replay.contracts.plugins import give_log
    from fbench.replay.contracts.sensor_settings import make_sensors
    from fbench.replay.contracts.variants import sensors_of
    from fbench.replay.setup.request import ReplayRequest
    from fbench.replay.setup.source import LogRequest, log_source

    require_codes(ignore or ())
    boxes = options.box_source(truth, truth_format, truth_frame)
    what = LogRequest(log, config, rig or (), boxes, topics=topics or (), decoder=decoder or ())
    source, settings = log_source(what), list(settings or ())
    request = ReplayRequest(what, pipeline or "", isolate=isolate, frame_timeout_s=frame_timeout_s)
    patterns = make_sensors(sensors or ())
    sync = source.sync_params(reference, timeout_ms, tolerance_ms, max_gap_s)
    stamp_params = source.stamps(stamps, offset or ())
    given = tuple(sensors_of(pipeline, patterns) if pipeline else patterns)
    faults, name = FaultLog(), short_name(pipeline) if pipeline else ""
    with (
        plugin_output(),
        open_requested(request, settings) if pipeline else nullcontext() as opened,
        explain_losses(faults),
    ):
        reader = source.open(faults)
        if opened is not None:
            give_log(opened[0], name, lambda: source.open(faults))
        total = sum(reader.container.counts.values())
        with message_progress(f"{log.name}: reading all", total) as progress:
            tried = None if opened is None else (name, opened[0])
            ignored = tuple(ignore or ())
            how = CheckOptions(sync, stamp_params, images, tried, given, ignored, progress)
            result = check_log(reader, faults, how)
    if json:
        print_json(_content(result))
    else:
        _print(log, result)
    raise typer.Exit(EXIT_NO if result.num_problems else EXIT_OK)


def _content(result: "CheckResult") -> dict[str, object]:
    return {
        "name": result.info.name,
        "log_id": result.info.log_id,
        "clean": result.num_problems == 0,
        "findings": [asdict(f) for f in result.findings],
        "storage": asdict(result.storage),
        "reference": result.reference,
        "streams": [asdict(s) for s in result.streams],
        "frames": None if result.frames is None else asdict(result.frames),
        "truth": {"messages": result.num_truths, "frames": result.num_labeled},
        "topics": [asdict(t) for t in result.topics],
    }


def _print(log: Path, result: "CheckResult") -> None:
    frames, summary = result.frames, "no frames"
    if frames is not None:
        segments = format_count(len(frames.breaks) + 1, "segment")
        complete = f"{format_count(frames.num_frames, 'frame')} by {result.reference}, {frames.num_complete} complete"
        summary = f"{complete}, {segments}, {result.num_labeled} with truth"
    say(f"{log}: {summary}")
    numbers = ("messages", "Hz", "period ms", "longest", "jitter p99", "arrival after stamp ms")
    table = make_table("sensor", "kind", *numbers, right=numbers)
    for s in result.streams:
        skew = f"{_ms(s.skew_median_ns)} ({_ms(s.skew_min_ns)} to {_ms(s.skew_max_ns)})"
        rate = "–" if s.rate_hz is None else f"{s.rate_hz:.1f}"
        times = (_ms(s.median_period_ns), _ms(s.max_gap_ns), _ms(s.jitter_p99_ns))
        no_skew = s.skew_median_ns is None
        table.add_row(s.sensor, s.kind, str(s.num_messages), rate, *times, "–" if no_skew else skew)
    console().print(table)
    for found in result.findings:
        source = f" {found.source}" if found.source else ""
        first = f" (first: {found.first})" if found.first else ""
        say(f"{found.severity} {found.code}{source}: {found.text}{first}")
        if found.severity != "info":
            say(f"    → {found.advice}")
    num = result.num_problems
    say("clean" if num == 0 else format_count(num, "finding"))


def _ms(value_ns: int | None) -> str:
    return "–" if value_ns is None else f"{value_ns / 1e6:.1f}"
