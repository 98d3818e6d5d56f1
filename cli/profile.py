"""`fbench profile`: record how long a pipeline takes on this machine, for `--latency profile:FILE` on any other."""

from pathlib import Path
from typing import Annotated

from typer import Option

from fbench.cli import options
from fbench.cli.progress import replay_progress
from fbench.cli.show import console, latency_table, plugin_output, print_json, say


def profile(
    log: options.Log,
    pipeline: options.PipelineOrFile = None,
    repeat: Annotated[int, Option(metavar="N", min=1, help="How often the log is replayed.")] = 3,
    settings: options.Settings = None,
    detect_every: options.DetectEvery = None,
    config: options.Config = None,
    rig: options.RigFiles = None,
    decoder: options.Decoders = None,
    sensors: options.Sensors = None,
    from_: options.From = None,
    to: options.To = None,
    frames: options.Frames = None,
    condition: options.Condition = "",
    seed: options.Seed = 0,
    device: options.Device = "cpu",
    isolate: options.Isolate = False,
    out: Annotated[Path, Option("--out", "-o", help="The file.")] = Path("profile.json"),
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> None:
    """Measure how long each stage of a pipeline takes by what a frame holds, and write it for replays elsewhere."""
    from fbench.api.profiles import ProfileRequest
    from fbench.api.profiles import profile as record_profile
    from fbench.replay.setup.request import ReplayRequest, choose_pipeline
    from fbench.replay.setup.source import LogRequest

    request = ReplayRequest(
        LogRequest(log, config, rig or (), decoder=decoder or ()), choose_pipeline(pipeline, None),
        settings=settings or (), detect_every=detect_every, sensors=sensors or (), from_=from_, to=to, frames=frames,
        condition=condition, seed=seed, out=out, overwrite=overwrite, on_fault="tolerant", device=device,
        isolate=isolate,
    )  # fmt: skip
    what = ProfileRequest(request, repeat)
    with replay_progress(f"{log.name} → {request.pipeline}") as progress, plugin_output():
        found = record_profile(what, progress)
    if json:
        facts = {"fps": found.fps, "real_time_factor": found.real_time_factor}
        print_json({"file": str(found.path), **facts, "latency": found.latency})
        return
    console().print(latency_table(dict(found.latency)))
    factor = "" if found.real_time_factor is None else f", {found.real_time_factor:.3g} times real time"
    say("", f"the pipeline alone: {found.fps:.3g} frames a second{factor}")
    say(f"frames: {len(found.profile.residuals_ns)} from {repeat} replays, without those of warm-up")
    say(f"profile: {found.path}")
