"""`fbench log export`."""

from pathlib import Path
from typing import Annotated

import typer

from fbench.replay.cli.options import Json


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
    from fbench.replay.cli.export_job import run_export
    from fbench.replay.export.place import Place
    from fbench.replay.export.run import Export
    from fbench.replay.export.wish import make_wish

    wish = make_wish(form, boxes, camera, frame, class_name)
    job = Export(sources, wish, Place(out, wish.is_nuscenes, overwrite), name)
    raise typer.Exit(run_export(job, json))
