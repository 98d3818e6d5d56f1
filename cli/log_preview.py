"""`fbench log preview`."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

from typer import Option

from fbench.cli import options
from fbench.cli.progress import frame_progress
from fbench.cli.show import fault_lines, print_json, say
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.scores import format_count

TIMEOUT_NS = 1_000_000_000
"""So long a frame waits for its sensors: also what a replay would find too late is drawn, as wrong stamps make it."""


def preview(
    log: options.Log,
    out: Annotated[Path | None, Option("--out", "-o", help="Folder for the pictures (default: LOG-preview).")] = None,
    frames: options.Frames = None,
    num: Annotated[int, Option(metavar="N", min=1, max=200, help="Number of evenly spaced frames.")] = 6,
    config: options.Config = None,
    rig: options.RigFiles = None,
    decoder: options.Decoders = None,
    truth: options.TruthFile = None,
    truth_format: options.TruthFormat = None,
    truth_frame: options.TruthFrame = "",
    reference: options.Reference = None,
    offset: options.Offset = None,
    stamps: options.Stamps = None,
    topics: options.Topics = None,
    condition: options.Condition = "",
    seed: options.Seed = 0,
    overwrite: Annotated[bool, Option("--overwrite", help="Replace an existing preview.")] = False,
    json: options.Json = False,
) -> None:
    """Draw the data of sensors into each other, to show whether calibration, time and Doppler are right; with
    conditions, each picture before and after.
    """
    from fbench.replay.contracts.faults import FaultLog, explain_losses
    from fbench.replay.engine.excerpt import make_excerpt
    from fbench.replay.logs.partial_rig import partial_rig
    from fbench.replay.setup.request import make_disturbance
    from fbench.replay.setup.source import LogRequest, log_source
    from fbench.reports.preview.collect import PreviewRequest, collect
    from fbench.reports.preview.preview import write_preview

    boxes = options.box_source(truth, truth_format, truth_frame)
    source = log_source(LogRequest(log, config, rig or (), boxes, topics=topics or (), decoder=decoder or ()))
    sync = replace(source.sync_params(reference, None, None, None), timeout_ns=TIMEOUT_NS)
    request = PreviewRequest(num, sync, source.stamps(stamps, offset or []), make_excerpt(None, None, frames))
    disturbance = make_disturbance(source, condition, seed)
    place = out or Path(f"{log.resolve().stem}-preview")
    faults = FaultLog()
    # What a decoder prints must not get between the lines of --json.
    with redirect_stdout(sys.stderr), explain_losses(faults), _new_folder(place, overwrite) as folder:
        reader = source.open(faults)
        with frame_progress(f"{log.name}: reading") as progress:
            material, disturbed = collect(reader, partial_rig(reader), request, faults, progress), None
            if disturbance:
                request = replace(request, disturbance=disturbance)
                disturbed = collect(reader, partial_rig(reader), request, FaultLog(), progress)
        names = "+".join(map(str, disturbance.parts))
        content = write_preview(material, folder, disturbed, f"{names}; seed {seed}" if names else "")
    sheet = place / "index.html"
    if json:
        print_json({
            "folder": str(place), "sheet": str(sheet), "sensors": [asdict(row) for row in content.sensors],
            "verdicts": [asdict(verdict) for verdict in content.verdicts], "gaps": list(content.gaps),
            "frames": [frame.index for frame in content.frames],
            "changed": {} if disturbed is None else dict(disturbed.effects),
            "pictures": [asdict(shown) for shown in content.pictures], "faults": faults.rows(),
        })  # fmt: skip
        return
    say(*(f"{'!' if v.is_bad else ' '} {v.what} {v.about}: {v.text}" for v in content.verdicts))
    say(*(f"  not shown: {gap}" for gap in content.gaps), *fault_lines(faults.rows()))
    if disturbed is not None:
        say(*(f"changed: {name}: {text}" for name, text in disturbed.effects.items()))
    num_frames = format_count(len(content.frames), "frame")
    say(f"preview: {sheet} ({num_frames}, {format_count(len(content.pictures), 'picture')})")


@contextmanager
def _new_folder(folder: Path, overwrite: bool) -> Iterator[Path]:
    """Give a folder under a temporary name, which becomes `folder` when all went well. Raises ConfigError where
    `folder` is there already and isn't to be replaced, or can't be written.
    """
    if folder.exists() and not overwrite:
        raise ConfigError(f"{folder}: exists already; choose another with --out, or --overwrite it")
    if folder.exists() and not (folder / "index.html").is_file() and (not folder.is_dir() or any(folder.iterdir())):
        raise ConfigError(f"{folder}: isn't a preview, so it isn't overwritten; choose another with --out")
    from fbench.replay.data.files import Draft

    with Draft(folder, is_folder=True) as draft:
        yield draft.path
        draft.publish()
