"""`fbench log export`."""

import sys
from contextlib import nullcontext, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from fbench.cli import options
from fbench.cli.progress import import_progress
from fbench.cli.show import fault_lines, print_json, say
from fbench.replay.contracts.errors import EXIT_LOSSY, EXIT_OK
from fbench.replay.data.scores import format_count

if TYPE_CHECKING:
    from fbench.replay.formats.export import Exported


def export(
    sources: Annotated[list[Path], Argument(metavar="SRC...", help="Run folders, or logs whose truth to export.")],
    form: Annotated[
        str,
        Option("--format", "-f", metavar="FORMAT", help="kitti, kitti-tracking, mot, nuscenes or nuscenes-tracking."),
    ],
    out: Annotated[
        Path, Option("--out", "-o", help="A folder for text files; FILE.json for all of nuScenes together.")
    ],
    boxes: Annotated[
        str | None,
        Option(
            metavar="WHICH",
            help="tracks, detections or truth (default: truth of a log; tracks of a run if the format needs ids, else "
            "its detections).",
        ),
    ] = None,
    camera: Annotated[str, Option(metavar="NAME", help="Camera of the 2D boxes (default: the only one).")] = "",
    frame: Annotated[
        str,
        Option(metavar="NAME", help="KITTI: coordinates of 3D boxes, a camera or 'body' (default: as the log says)."),
    ] = "",
    class_name: Annotated[
        str, Option("--class", metavar="NAME", help="Class to write for boxes without one, in the format's terms.")
    ] = "",
    name: Annotated[
        str, Option(metavar="NAME", help="Name of the files of a single SRC (default: the name of its log).")
    ] = "",
    decoder: options.Decoders = None,
    overwrite: Annotated[bool, Option("--overwrite", help="Replace an earlier export.")] = False,
    json: options.Json = False,
) -> None:
    """Write results or truth as files that the official tools of KITTI, MOTChallenge and nuScenes read."""
    from fbench.replay.contracts.faults import FaultLog, explain_losses
    from fbench.replay.formats.export import Export
    from fbench.replay.formats.export import export as export_sources
    from fbench.replay.formats.export_request import make_export_request

    request = make_export_request(form, boxes, camera, frame, class_name)
    job = Export(sources, request, out, overwrite, name, decoder or ())
    faults, done = FaultLog(), list["Exported"]()
    quiet = redirect_stdout(sys.stderr) if json else nullcontext()  # what a decoder prints is no line of --json
    with quiet, explain_losses(faults), import_progress(len(sources)) as progress:
        for exported in export_sources(job, faults, progress):
            done.append(exported)
            with progress.finish(exported.num_frames):
                if not json:
                    frames = format_count(exported.num_frames, "frame")
                    counts = f"{format_count(exported.num_rows, 'row')} in {frames}, {exported.view}"
                    left = ", ".join(f"{num} {reason}" for reason, num in exported.left_out.items())
                    say(f"{exported.name}: {counts}{f'; left out: {left}' if left else ''}")
    if json:
        names = {"name": "name", "frames": "num_frames", "rows": "num_rows", "left_out": "left_out", "view": "view"}
        sequences = [{key: getattr(one, name) for key, name in names.items()} for one in done]
        print_json({"format": request.format, "path": str(out), "sequences": sequences, "faults": faults.rows()})
    else:
        say(*fault_lines(faults.rows()), f"{request.format}: {out}")
    raise typer.Exit(EXIT_LOSSY if faults.num_lost else EXIT_OK)
