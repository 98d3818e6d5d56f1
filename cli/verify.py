"""`fbench verify`."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from fbench.cli import options
from fbench.cli.progress import replay_progress
from fbench.cli.show import console, make_table, plugin_output, print_json, say
from fbench.replay.contracts.errors import EXIT_NO, EXIT_OK, ConfigError

if TYPE_CHECKING:
    from fbench.api.relations import Relations
    from fbench.replay.check.verify import Verified
    from fbench.replay.setup.request import ReplayRequest

_METRICS = ("agreement_detections", "agreement_tracks", "identity_changes")
_MOST_OBJECTS = 10


def verify(
    log: options.Log,
    pipeline: options.PipelineOrFile = None,
    settings: options.Settings = None,
    detect_every: options.DetectEvery = None,
    latency: options.Latency = None,
    overload: options.Overload = None,
    config: options.Config = None,
    rig: options.RigFiles = None,
    decoder: options.Decoders = None,
    truth: options.TruthFile = None,
    truth_format: options.TruthFormat = None,
    truth_frame: options.TruthFrame = "",
    detections: options.DetectionsFile = None,
    repeat: Annotated[
        int | None, Option(min=1, max=100, help="Number of identical replays, including the first (default: 2).")
    ] = None,
    quick: Annotated[bool, Option("--quick", help="Only repeat, change the hash seed, and use more threads.")] = False,
    relations: Annotated[
        bool, Option("--relations", help="Instead, change the log in ways that must not change results: mirror it ...")
    ] = False,
    keep: Annotated[Path | None, Option(help="Folder in which to keep the runs of all replays.")] = None,
    reference: options.Reference = None,
    timeout_ms: options.TimeoutMs = None,
    tolerance_ms: options.ToleranceMs = None,
    max_gap_s: options.MaxGapS = None,
    from_: options.From = None,
    to: options.To = None,
    frames: options.Frames = None,
    topics: options.Topics = None,
    sensors: options.Sensors = None,
    offset: options.Offset = None,
    stamps: options.Stamps = None,
    device: options.Device = "cpu",
    isolate: options.Isolate = False,
    frame_timeout_s: options.FrameTimeoutS = 10.0,
    condition: options.Condition = "",
    seed: options.Seed = 0,
    json: options.Json = False,
) -> None:
    """Replay in fresh processes under other rates, containers, hash seeds and threads, and name what differs first."""
    from fbench.api.replays import short_name
    from fbench.api.replays import verify as verify_replay
    from fbench.replay.setup.request import ReplayRequest, choose_pipeline
    from fbench.replay.setup.source import LogRequest

    boxes = options.box_source(truth, truth_format, truth_frame)
    results = options.box_source(detections, None, truth_frame)
    source = LogRequest(log, config, rig or (), boxes, results, topics or (), decoder or ())
    request = ReplayRequest(
        source,
        choose_pipeline(pipeline, results),
        settings=settings or (),
        detect_every=detect_every,
        latency=latency,
        overload=overload,
        sensors=sensors or (),
        reference=reference,
        timeout_ms=timeout_ms,
        tolerance_ms=tolerance_ms,
        max_gap_s=max_gap_s,
        offset=offset or (),
        stamps=stamps,
        from_=from_,
        to=to,
        frames=frames,
        device=device,
        isolate=isolate,
        frame_timeout_s=frame_timeout_s,
        condition=condition,
        seed=seed,
    )
    if relations and (quick or repeat is not None):
        raise ConfigError(f"--relations doesn't repeat: leave out {'--quick' if quick else '--repeat'}")
    if relations:
        raise typer.Exit(_check_relations(request, log, keep, json))
    with replay_progress(f"{log.name} → {short_name(request.pipeline)}") as progress:
        found = verify_replay(request, 2 if repeat is None else repeat, quick, keep, progress)
    if json:
        rows = [
            {"variant": name, "difference": odd and asdict(odd), "identical": not odd}
            for name, odd in found.differences.items()
        ]
        content = {"log": str(log), "pipeline": request.pipeline, "identical": found.identical}
        print_json({**content, "stages": dict(found.digests), "variants": rows})
    else:
        _print(found)
        say(*([f"device: {device}"] if device != "cpu" else []))
    raise typer.Exit(EXIT_OK if found.identical else EXIT_NO)


def _print(found: "Verified") -> None:
    table = make_table("stage", "digest")
    for stage, text in found.digests.items():
        table.add_row(stage, text)
    console().print(table)
    say("")
    for variant, odd in found.differences.items():
        say(f"{odd} under {variant}" if odd else f"{variant}: identical")
    num, total = sum(map(bool, found.differences.values())), len(found.differences)
    say("", f"DIVERGED: {num} of {total}" if num else f"identical: all {total}")


def _check_relations(request: "ReplayRequest", log: Path, keep: Path | None, json: bool) -> int:
    """Replay under relations, print what holds, and return the exit code."""
    from fbench.api.relations import check_relations
    from fbench.api.replays import short_name

    with replay_progress(f"{log.name} → {short_name(request.pipeline)}") as progress, plugin_output():
        found = check_relations(request, keep, progress)
    if json:
        rows = [
            {"relation": one.name, "change": one.change, "least": one.least, "violated": one.is_violated,
             "reason": one.reason, **{metric: one.value(metric) for metric in _METRICS}}
            for one in found.held
        ]  # fmt: skip
        objects = [str(change) for change in found.objects]
        print_json({"log": str(log), "pipeline": request.pipeline, "relations": rows, "objects": objects})
    else:
        _print_relations(found)
    return EXIT_NO if found.is_violated else EXIT_OK


def _print_relations(found: "Relations") -> None:
    table = make_table("relation", "change", *_METRICS, "least", "", right=(*_METRICS, "least"))
    for one in found.held:
        numbers = ("–" if (value := one.value(metric)) is None else f"{value:.4g}" for metric in _METRICS)
        verdict = "VIOLATED" if one.is_violated else "holds" if one.agreement is not None else "not tried"
        style = {"VIOLATED": "red", "not tried": "yellow"}.get(verdict)
        table.add_row(one.name, one.change, *numbers, f"{one.least:g}", verdict, style=style)
    console().print(table)
    say(*(f"{one.name}: {one.reason}" for one in found.held if one.reason))
    say(*(f"{change.cell}: {change}" for change in found.objects[:_MOST_OBJECTS]))
    if (more := len(found.objects) - _MOST_OBJECTS) > 0:
        say(f"... {more} more, see --json")
    num = sum(one.is_violated for one in found.held)
    say(f"VIOLATED: {num} of {len(found.held)} relations" if num else "no relation is violated")
