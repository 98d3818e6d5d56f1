"""`fbench log ...`."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from fbench.cli import options as examples
from fbench.cli.options import (
    Config,
    Frames,
    Json,
    Log,
    MaxGapS,
    Offset,
    Reference,
    RigFiles,
    Sensors,
    Settings,
    Stamps,
    TimeoutMs,
    ToleranceMs,
    Topics,
    TruthFile,
    TruthFormat,
    TruthFrame,
)


def convert(
    source: Log,
    out: Annotated[Path, typer.Option("--out", "-o", help="NAME.mcap, NAME.parquet, or a folder of parts.")],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing log.")] = False,
    compression: Annotated[
        str, typer.Option(metavar="NAME", help="MCAP: zstd, lz4 or none. Parquet: zstd, snappy or none.")
    ] = "zstd",
    chunk_size: Annotated[int | None, typer.Option(metavar="BYTES", help="Of MCAP; else 1 MiB.")] = None,
    rows_per_group: Annotated[
        int | None, typer.Option(metavar="N", help="Of Parquet; else as many as make 8 MiB.")
    ] = None,
    from_: Annotated[
        str | None,
        typer.Option("--from", metavar="T", help="Cut: seconds after the first measurement, or a log time 'Nns'."),
    ] = None,
    to: Annotated[str | None, typer.Option("--to", metavar="T", help="Where to stop, itself left out.")] = None,
    topics: Annotated[
        list[str] | None,
        typer.Option("--topics", metavar="PATTERN", help="Keep these topics or sensors (not: '!PATTERN'); repeatable."),
    ] = None,
    split_s: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Write a folder of MCAP files, each of this duration.")
    ] = None,
    split_mb: Annotated[
        float | None, typer.Option(metavar="MB", help="Write a folder of MCAP files, each of about this size.")
    ] = None,
    decode: Annotated[
        bool, typer.Option("--decode", help="Turn the log of others into fbench's own messages; the rest is left out.")
    ] = False,
    config: Config = None,
    rig: RigFiles = None,
    json: Json = False,
) -> None:
    """Write a log in another form, without loss; cut it by time, keep some topics, or split it."""
    from fbench.cli.convert_jobs import run_convert
    from fbench.replay.contracts.errors import ConfigError
    from fbench.replay.engine.excerpt import make_excerpt
    from fbench.replay.logs.convert.run import Wish
    from fbench.replay.logs.convert.target import Target, make_split
    from fbench.replay.logs.setup import Setup
    from fbench.replay.setup.source import NO_CONFIG, LogRequest, log_source

    target = Target(out, overwrite, compression, chunk_size, rows_per_group, make_split(split_s, split_mb))
    if not decode and (rig or config not in (None, NO_CONFIG)):
        raise ConfigError(
            "--config and --rig change what is decoded: give --decode too, or leave them to `fbench replay`"
        )
    setup = log_source(LogRequest(source, config, rig or [])).setup if decode else Setup()
    wish = Wish(tuple(topics or ()), make_excerpt(from_, to, None), decode, setup)
    raise typer.Exit(run_convert(source, target, wish, json))


def export(
    sources: Annotated[
        list[Path], typer.Argument(metavar="SRC...", help="Run folders, or logs whose truth is wanted.")
    ],
    form: Annotated[
        str,
        typer.Option(
            "--format", "-f", metavar="FORMAT", help="kitti, kitti-tracking, mot, nuscenes or nuscenes-tracking."
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="A folder for text files; FILE.json for all of nuScenes together.")
    ],
    boxes: Annotated[
        str | None,
        typer.Option(
            metavar="WHICH",
            help="tracks, detections or truth; else tracks of a run where the format needs ids, detections where it "
            "doesn't, and truth of a log.",
        ),
    ] = None,
    camera: Annotated[
        str, typer.Option(metavar="NAME", help="Whose image 2D boxes are in; else the only camera.")
    ] = "",
    frame: Annotated[
        str,
        typer.Option(
            metavar="NAME", help="KITTI: camera, or 'body', in whose coordinates 3D boxes are; else as the log says."
        ),
    ] = "",
    class_name: Annotated[
        str, typer.Option("--class", metavar="NAME", help="Class of boxes that have none, as the format calls it.")
    ] = "",
    name: Annotated[str, typer.Option(metavar="NAME", help="Of the files of a single SRC; else as its log.")] = "",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier export.")] = False,
    json: Json = False,
) -> None:
    """Write results or truth as files that the official tools of KITTI, MOTChallenge and nuScenes read."""
    from fbench.cli.convert_jobs import run_export
    from fbench.replay.formats.export import Export, Place
    from fbench.replay.formats.export_request import make_export_request

    request = make_export_request(form, boxes, camera, frame, class_name)
    job = Export(sources, request, Place(out, request.is_nuscenes, overwrite), name)
    raise typer.Exit(run_export(job, json))


def import_(
    dataset: Annotated[str, typer.Argument(help="Which dataset, such as kitti; see `fbench plugins datasets`.")],
    source: Annotated[Path, typer.Argument(metavar="SRC", help="The dataset's folder.")],
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help="FILE.mcap or FOLDER.parquet for one sequence, else a folder for all logs."),
    ],
    scenes: Annotated[
        list[str] | None,
        typer.Option("--scenes", metavar="PATTERN", help="Only these sequences, such as 'scene-01*'; repeatable."),
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option("--frames", metavar="A:B", help="Only these frames, as the dataset numbers them, B left out."),
    ] = None,
    detections: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Take in another system's results; KITTI's benchmarks have files for them."),
    ] = None,
    settings: Settings = None,
    skip_bad: Annotated[
        bool, typer.Option("--skip-bad", help="Skip and count what can't be used, instead of ending there; exit 4.")
    ] = False,
    form: Annotated[Literal["mcap", "parquet"], typer.Option(help="Of the logs in a folder.")] = "mcap",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace existing logs.")] = False,
    json: Json = False,
) -> None:
    """Turn a public dataset into fbench logs; an import that was interrupted goes on when it is run again."""
    from fbench.cli.import_job import ImportJob, run_import

    wanted = [] if detections is None else [_detections(dataset, detections)]
    job = ImportJob(
        dataset=dataset,
        source=source,
        out=out,
        settings=[*wanted, *(settings or [])],
        scenes=scenes or [],
        frames=frames,
        skip_bad=skip_bad,
        form=form,
        overwrite=overwrite,
        as_json=json,
    )
    raise typer.Exit(run_import(job))


def _detections(dataset: str, folder: Path) -> str:
    from dataclasses import fields

    from fbench.replay.contracts.errors import ConfigError
    from fbench.replay.contracts.plugins import default_params, load

    params = default_params(load("datasets", dataset))
    if params is None or "detections" not in {f.name for f in fields(params)}:
        raise ConfigError(f"--detections {folder}: the importer of {dataset} takes no other system's results")
    return f"detections={folder}"


def preview(
    log: Log,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder of the pictures; else LOG-preview.")] = None,
    frames: Frames = None,
    num: Annotated[int, typer.Option(metavar="N", min=1, max=200, help="So many frames, evenly spread.")] = 6,
    config: Config = None,
    rig: RigFiles = None,
    truth: TruthFile = None,
    truth_format: TruthFormat = None,
    truth_frame: TruthFrame = "",
    reference: Reference = None,
    offset: Offset = None,
    stamps: Stamps = None,
    topics: Topics = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing preview.")] = False,
    json: Json = False,
) -> None:
    """Draw what sensors see into each other: whether calibration, time and Doppler are right shows at one look."""
    from fbench.cli.convert_jobs import TIMEOUT_NS, PreviewJob, run_preview
    from fbench.cli.options import box_source
    from fbench.replay.engine.excerpt import make_excerpt
    from fbench.replay.setup.source import LogRequest, log_source

    filed = box_source(truth, truth_format, truth_frame)
    source = log_source(LogRequest(log, config, rig or [], filed, None, topics or []))
    job = PreviewJob(
        log=source,
        out=out,
        overwrite=overwrite,
        num=num,
        sync=replace(source.sync(reference, None, None, None), timeout_ns=TIMEOUT_NS),
        stamps=source.stamps(stamps, offset or []),
        excerpt=make_excerpt(None, None, frames),
        as_json=json,
    )
    run_preview(job)


def simulate(
    world: Annotated[
        str,
        typer.Argument(
            metavar="WORLD",
            help="urban, highway; suite: all logs of the fixed suite; training: those of the built-in detector.",
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="FILE.mcap or FOLDER.parquet; of a suite the folder for its logs.")
    ],
    condition: Annotated[
        str,
        typer.Option(
            metavar="NAME", help="clear, traffic, rain, heavy-rain, fog, night ..., or a mixture: rain+night."
        ),
    ] = "clear",
    seconds: Annotated[float, typer.Option(metavar="S", help="Length of the log, in s.")] = 10.0,
    seed: Annotated[
        int, typer.Option(metavar="N", help="Another seed, another world; the same one, the same bytes.")
    ] = 0,
    split: Annotated[
        Literal["dev", "test"] | None,
        typer.Option(help="Of a suite: seeds to develop on (dev, unless said otherwise), or those to report."),
    ] = None,
    rig: Annotated[
        Path | None, typer.Option("--rig", metavar="FILE", help="TOML with the sensors; else the thesis's rig.")
    ] = None,
    sensors: Annotated[
        list[str] | None,
        typer.Option("--sensors", metavar="PATTERN", help="Only these sensors (not: '!PATTERN'); repeatable."),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Change a sensor or the weather; repeatable."),
    ] = None,
    threads: Annotated[
        int | None, typer.Option(metavar="N", min=1, max=256, help="Messages made at once; changes no byte.")
    ] = None,
    form: Annotated[
        Literal["mcap", "parquet"] | None, typer.Option(help="Of a suite's logs; mcap, unless said otherwise.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace existing logs.")] = False,
    json: Json = False,
) -> None:
    """Simulate a drive through a city or along a highway, with every sensor and perfect truth."""
    from fbench.cli.simulate_job import SimulateJob, run_simulation
    from fbench.datasets.city.request import CityRequest

    wish = CityRequest(world, condition, seconds, seed, rig, tuple(sensors or ()), tuple(settings or ()))
    run_simulation(SimulateJob(wish, out, split, threads, form, overwrite, json))


app = typer.Typer(help="Look into logs and make them.", no_args_is_help=True)


@app.command("info", epilog=examples.LOG_INFO)
def info(log: Log, config: Config = None, rig: RigFiles = None, json: Json = False) -> None:
    """Show what a log holds: topics, rates, duration, sensors, calibration, truth, segments."""
    from fbench.cli.log_info import show_info
    from fbench.replay.setup.source import LogRequest, log_source

    raise typer.Exit(show_info(log_source(LogRequest(log, config, rig or [])), json))


@app.command("check", epilog=examples.LOG_CHECK)
def check(
    log: Log,
    pipeline: Annotated[
        str | None, typer.Option("--pipeline", "-p", metavar="NAME", help="Say what this pipeline would miss too.")
    ] = None,
    settings: Settings = None,
    config: Config = None,
    rig: RigFiles = None,
    truth: TruthFile = None,
    truth_format: TruthFormat = None,
    truth_frame: TruthFrame = "",
    reference: Reference = None,
    timeout_ms: TimeoutMs = None,
    tolerance_ms: ToleranceMs = None,
    max_gap_s: MaxGapS = None,
    topics: Topics = None,
    sensors: Sensors = None,
    offset: Offset = None,
    stamps: Stamps = None,
    ignore: Annotated[
        list[str] | None, typer.Option(metavar="CODE", help="Show these findings as information only; repeatable.")
    ] = None,
    images: Annotated[bool, typer.Option("--images", help="Decode images whole, not only their headers.")] = False,
    json: Json = False,
) -> None:
    """Read a whole log and report what is wrong: exit 0 clean, 1 findings, 3 unreadable."""
    from fbench.cli.log_check import CheckRequest, run_check
    from fbench.cli.options import box_source
    from fbench.replay.setup.request import ReplayRequest
    from fbench.replay.setup.source import LogRequest

    request = ReplayRequest(
        LogRequest(log, config, rig or (), box_source(truth, truth_format, truth_frame), None, topics or ()),
        pipeline or "",
        settings or (),
        sensors=sensors or (),
        reference=reference,
        timeout_ms=timeout_ms,
        tolerance_ms=tolerance_ms,
        max_gap_s=max_gap_s,
        offset=offset or (),
        stamps=stamps,
    )
    raise typer.Exit(run_check(CheckRequest(request, ignore or (), images), json))


app.command("preview", epilog=examples.LOG_PREVIEW)(preview)
app.command("convert", epilog=examples.LOG_CONVERT)(convert)


app.command("import", epilog=examples.LOG_IMPORT)(import_)
app.command("export", epilog=examples.LOG_EXPORT)(export)
app.command("simulate", epilog=examples.LOG_SIMULATE)(simulate)
