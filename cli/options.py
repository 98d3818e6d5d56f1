"""Options that several commands share, and the examples shown by `--help`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

Log = Annotated[Path, Argument(metavar="LOG", help="An MCAP file, Parquet folder, ROS bag, or folder of parts.")]
Pipeline = Annotated[
    str, Option("--pipeline", "-p", metavar="NAME", help="A name (see fbench plugins), FILE.py:CLASS or FILE.toml.")
]
Settings = Annotated[list[str] | None, Option("--set", metavar="NAME=VALUE", help="Change a parameter; repeatable.")]
RunFolder = Annotated[Path, Argument(metavar="RUN", help="A run folder.")]
Json = Annotated[bool, Option("--json", help="Print JSON for machines.")]
Overwrite = Annotated[bool, Option("--overwrite", help="Replace an existing run.")]
RangeM = Annotated[float, Option("--range-m", metavar="M", min=0, help="Score objects within this distance, in m.")]
InView = Annotated[bool, Option("--in-view/--all-around", help="Score only objects that a camera sees.")]
DistanceM = Annotated[
    float, Option("--distance-m", metavar="M", min=0, help="3D match: centers this near on the ground, in m.")
]
Reference = Annotated[
    str | None, Option("--reference", metavar="SENSOR", help="Whose stamps are the frames' instants.")
]
TimeoutMs = Annotated[
    float | None,
    Option(
        "--timeout-ms",
        metavar="MS",
        min=0,
        help="How long a frame waits for its sensors, in ms; else 30, or as the log says.",
    ),
]
ToleranceMs = Annotated[
    float | None,
    Option("--tolerance-ms", metavar="MS", min=0, help="How far stamps may lie from the instant, in ms; else 50."),
]
MaxGapS = Annotated[
    float | None, Option("--max-gap-s", metavar="S", min=0, help="A longer pause begins a new segment, in s; else 2.")
]
From = Annotated[
    str | None,
    Option("--from", metavar="T", help="First instant: seconds after the first measurement, or a stamp 'Nns'."),
]
To = Annotated[str | None, Option("--to", metavar="T", help="Instant at which to stop, itself left out.")]
Frames = Annotated[str | None, Option("--frames", metavar="A:B", help="Indices of frames, B left out.")]
Topics = Annotated[
    list[str] | None,
    Option("--topics", metavar="PATTERN", help="Read only these topics or sensors (not: '!PATTERN'); repeatable."),
]
Sensors = Annotated[
    list[str] | None,
    Option("--sensors", metavar="PATTERN", help="Give the pipeline only these sensors (not: '!PATTERN'); repeatable."),
]
Offset = Annotated[
    list[str] | None, Option("--offset", metavar="SENSOR=MS", help="Add this to the stamps of a sensor; repeatable.")
]
Stamps = Annotated[
    str | None,
    Option(
        "--stamps",
        metavar="SOURCE",
        help="Instants are those of the 'header' (by default), or of the 'log', when it was recorded.",
    ),
]
ReadAhead = Annotated[
    str, Option("--read-ahead", metavar="N", help="Messages to decode in advance: a number, 'all' or 'auto'.")
]
InterpolateTruthMs = Annotated[
    float,
    Option(
        "--interpolate-truth",
        metavar="MS",
        min=0,
        help="Frames without truth of their own get some by interpolation between truths that are at most this far "
        "apart, in ms; 0: they don't.",
    ),
]
MinCoverage = Annotated[
    float,
    Option("--min-coverage", metavar="SHARE", min=0, max=1, help="Exit 1 where a smaller share of outputs had truth."),
]
NoMedia = Annotated[bool, Option("--no-media", help="Keep no images and no points in the run.")]
Redact = Annotated[
    bool, Option("--redact", help="Also leave out names of the log and of files, paths, places of faults and poses.")
]
Iou = Annotated[float, Option("--iou", metavar="SHARE", min=0, max=1, help="2D match: at least this overlap.")]


_HEAD = "[bold]Examples[/bold]\n\n"

DEMO = f"{_HEAD}fbench demo\n\nfbench demo --out /tmp/demo\n\nfbench demo --split test -o runs/suite"
INIT = f"{_HEAD}fbench init log.mcap\n\nfbench init log.mcap -o configs/car.toml --overwrite"
REPLAY = (
    f"{_HEAD}fbench replay log.mcap --pipeline lidar3d\n\n"
    "fbench replay log.mcap -p late3d --set camera.weights=yolox.onnx --rate 2 -o runs/mine --report\n\n"
    "fbench replay log.mcap -p my_pipeline.py:MyPipeline\n\n"
    "fbench replay log.mcap -p 'exec:./my_stack --fast' --truth labels.csv\n\n"
    "fbench replay log.mcap -p recorded:/perception/tracks"
)
SCORE = (
    f"{_HEAD}fbench score runs/log-lidar3d\n\nfbench score runs/log-lidar3d --range-m 80 --all-around\n\n"
    "fbench score runs/log-lidar3d --truth label_02/0003.txt\n\n"
    "fbench score runs/log-lidar3d --explain 12\n\n"
    "fbench score runs/city1-late3d runs/city2-late3d --intervals 1000 -o together.json\n\n"
    "fbench score runs/log-lidar3d --profile kitti-3dmot --match iou3d:0.25\n\n"
    "fbench score --truth label_02 --detections tracker/data --profile trackeval-kitti -o scores.json\n\n"
    "fbench score --truth MOT17/train --detections results --profile trackeval-mot --sequences MOT17-02,MOT17-04\n\n"
    "fbench score --truth truth.json --detections submission.json --profile nuscenes-detection --json"
)
REPORT = f"{_HEAD}fbench report runs/log-lidar3d\n\nfbench report runs/log-lidar3d runs/log-late3d -o both.html"
COMPARE = f"{_HEAD}fbench compare runs/base runs/head\n\nfbench compare runs/base runs/head --tolerance 0.01"
VERIFY = (
    f"{_HEAD}fbench verify log.mcap -p lidar3d\n\n"
    "fbench verify log.mcap -p my_pipeline.py:MyPipeline --quick --repeat 3 --frames :50"
)
PLUGINS = (
    f"{_HEAD}fbench plugins\n\nfbench plugins pipelines late3d\n\nfbench plugins metrics hota\n\n"
    "fbench plugins profiles kitti-3dmot"
)
LOG_INFO = f"{_HEAD}fbench log info log.mcap\n\nfbench log info log.mcap --json"
LOG_CHECK = (
    f"{_HEAD}fbench log check log.mcap\n\nfbench log check log.mcap -p late3d --timeout-ms 50\n\n"
    "fbench log check log.bag --ignore LOG006 --json"
)
LOG_PREVIEW = (
    f"{_HEAD}fbench log preview log.mcap\n\nfbench log preview log.mcap -o pictures --frames 100:200 --num 4\n\n"
    "fbench log preview log.bag --offset lidar=-50 --topics '!rear*' --overwrite"
)
LOG_CONVERT = (
    f"{_HEAD}fbench log convert drive.mcap -o drive.parquet\n\n"
    "fbench log convert drive.bag -o part.mcap --from 12.5 --to 20 --topics '/lidar*'\n\n"
    "fbench log convert drive.mcap -o drive --split-s 60"
)
LOG_IMPORT = (
    f"{_HEAD}fbench log import astyx path/to/astyx -o astyx.mcap\n\n"
    "fbench log import nuscenes path/to/nuscenes -o logs --scenes 'scene-01*' --skip-bad\n\n"
    "fbench log import kitti path/to/tracking -o 0012.mcap --scenes 0012 --detections results"
)
LOG_EXPORT = (
    f"{_HEAD}fbench log export runs/0003-lidar3d --format kitti-tracking --class Car -o results/data\n\n"
    "fbench log export kitti/0000.mcap kitti/0001.mcap --format kitti-tracking -o label_02\n\n"
    "fbench log export runs/scene-*-late3d --format nuscenes -o submission.json"
)
LOG_SIMULATE = (
    f"{_HEAD}fbench log simulate urban --condition fog --seconds 10 --seed 3 -o fog.mcap\n\n"
    "fbench log simulate highway --sensors 'lidar,radar' --set weather.rain_mm_h=30 -o rain.mcap\n\n"
    "fbench log simulate suite --split test -o suite"
)
WEIGHTS_LIST = f"{_HEAD}fbench weights list\n\nfbench weights list --json"
WEIGHTS_GET = (
    f"{_HEAD}fbench weights get deimv2-femto\n\n"
    "fbench weights get yolox-tiny --from downloads/yolox_tiny.onnx\n\n"
    "fbench replay log.mcap -p late3d --set camera.weights=deimv2-femto"
)
WEIGHTS_TRAIN = (
    f"{_HEAD}fbench log simulate training -o training\n\n"
    "fbench weights train training -o city.onnx\n\n"
    "fbench replay log.mcap -p camera2d --set camera.weights=city.onnx"
)


if TYPE_CHECKING:
    from fbench.replay.logs.setup import BoxSource

Config = Annotated[
    str | None,
    Option("--config", metavar="FILE", help="An fbench.toml; else the one beside the log; 'none': none at all."),
]
RigFiles = Annotated[
    list[Path] | None,
    Option("--rig", metavar="FILE", help="Calibration: TOML, URDF, Kalibr or camera_info YAML; repeatable."),
]
TruthFile = Annotated[Path | None, Option("--truth", metavar="PATH", help="Ground truth from this file or folder.")]
TruthFormat = Annotated[
    str | None, Option("--truth-format", metavar="FORMAT", help="Of --truth, where its content doesn't tell.")
]
TruthFrame = Annotated[
    str,
    Option(
        "--truth-frame", metavar="NAME", help="Coordinate frame, or camera, of --truth, where the file doesn't tell."
    ),
]
DetectionsFile = Annotated[
    Path | None,
    Option("--detections", metavar="PATH", help="Score these results of another system, from a file or folder."),
]
PipelineOrFile = Annotated[
    str | None,
    Option(
        "--pipeline", "-p", metavar="NAME",
        help="A name (see fbench plugins), FILE.py:CLASS, FILE.toml, recorded:TOPIC or 'exec:COMMAND'.",
    ),
]  # fmt: skip


def box_source(path: Path | None, form: str | None, frame: str) -> "BoxSource | None":
    """Return a file of boxes as the command line names it; `frame` is the camera too, where there are 2D boxes."""
    from fbench.replay.logs.setup import BoxSource

    return None if path is None else BoxSource(path, form, frame, frame)


DetectEvery = Annotated[
    int | None,
    Option(
        "--detect-every", metavar="N", min=1, help="Detect in every N-th frame only; tracks are predicted in between."
    ),
]
