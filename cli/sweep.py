"""`fbench sweep`: how fast sensors may come before a pipeline falls behind, and what its outputs are worth then."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from fbench.cli import options
from fbench.cli.progress import replay_progress
from fbench.cli.show import console, make_table, print_json, say
from fbench.replay.data.scores import DASH, FORECAST, LOCKSTEP, STREAMING

if TYPE_CHECKING:
    from fbench.api.sweeps import RateSweep


def sweep(
    log: options.Log,
    pipeline: options.PipelineOrFile = None,
    latency: options.Latency = None,
    overload: options.Overload = None,
    rates: Annotated[
        str, Option(metavar="RATE,RATE", help="How many times as fast as in real time the log passes.")
    ] = "0.5,1,2,4,8",
    budget_ms: options.BudgetMs = 100.0,
    settings: options.Settings = None,
    config: options.Config = None,
    rig: options.RigFiles = None,
    decoder: options.Decoders = None,
    truth: options.TruthFile = None,
    truth_format: options.TruthFormat = None,
    truth_frame: options.TruthFrame = "",
    detections: options.DetectionsFile = None,
    sensors: options.Sensors = None,
    from_: options.From = None,
    to: options.To = None,
    frames: options.Frames = None,
    condition: options.Condition = "",
    seed: options.Seed = 0,
    device: options.Device = "cpu",
    out: Annotated[Path, Option("--out", "-o", help="Folder of the runs and of sweep.json.")] = Path("runs/sweep"),
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> None:
    """Replay a log at several rates, and print what is dropped and what outputs are worth when they are ready."""
    from fbench.api.sweeps import SweepRequest, sweep_content
    from fbench.api.sweeps import sweep as sweep_log
    from fbench.replay.setup.request import ReplayRequest, choose_pipeline
    from fbench.replay.setup.source import LogRequest

    boxes = options.box_source(truth, truth_format, truth_frame)
    results = options.box_source(detections, None, truth_frame)
    request = ReplayRequest(
        LogRequest(log, config, rig or (), boxes, results, decoder=decoder or ()), choose_pipeline(pipeline, results),
        settings=settings or (), sensors=sensors or (), from_=from_, to=to, frames=frames, condition=condition,
        seed=seed, out=out, overwrite=overwrite, on_fault="tolerant", no_media=True, latency=latency, overload=overload,
        budget_ms=budget_ms, device=device,
    )  # fmt: skip
    what = SweepRequest(request, [rate.strip() for rate in rates.split(",")])
    with replay_progress(f"{log.name} → {request.pipeline}") as progress:
        found = sweep_log(what, progress)
    if json:
        print_json({"folder": str(found.folder), **sweep_content(found)})
    else:
        _print(found, budget_ms)


def _print(found: "RateSweep", budget_ms: float) -> None:
    metrics = list(dict.fromkeys(metric for row in found.rows for metric in row.scores[STREAMING]))
    names = ["rate", "dropped %", "missed %", "age ms", *metrics, *(f"{metric}, forecast" for metric in metrics)]
    table = make_table(*names, right=names)
    for row in found.rows:
        shares = (f"{100 * num / row.frames:.1f}" for num in (row.dropped, row.missed))
        values = [row.scores[part].get(metric) for part in (STREAMING, FORECAST) for metric in metrics]
        age = DASH if row.staleness_ms is None else f"{row.staleness_ms:.1f}"
        table.add_row(f"{row.rate:g}x", *shares, age, *(DASH if v is None else f"{v:.3f}" for v in values))
    console().print(table)
    known = found.rows[0].scores[LOCKSTEP]
    lockstep = ", ".join(f"{metric} {value:.3f}" for metric, value in known.items() if value is not None)
    largest = found.sustainable_rate
    kept = "at no rate" if largest is None else f"up to {largest:g}x"
    say("", *([f"in lockstep: {lockstep}"] if lockstep else []))
    say(f"sustained {kept}: less than 1 % of the frames are dropped, or done later than {budget_ms:g} ms after ready")
    say(f"sweep: {found.folder}", f"plots: {found.folder / 'report.html'}")
