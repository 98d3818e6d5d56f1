"""Options that several commands share, and the examples shown by `--help`."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Argument, Option

if TYPE_CHECKING:
    from fbench.replay.logs.setup import BoxSource

Log = Annotated[Path, Argument(metavar="LOG", help="An MCAP file, Parquet folder, ROS bag, or folder of parts.")]
Settings = Annotated[list[str] | None, Option("--set", metavar="NAME=VALUE", help="Change a parameter; repeatable.")]
Json = Annotated[bool, Option("--json", help="Print JSON for machines.")]
Overwrite = Annotated[bool, Option("--overwrite", help="Replace an existing run.")]
RangeM = Annotated[float, Option(metavar="M", min=0, help="Score objects within this distance, in m.")]
InView = Annotated[bool, Option("--in-view/--all-around", help="Score only objects that a camera sees.")]
DistanceM = Annotated[
    float, Option(metavar="M", min=0, help="3D match: maximum distance of centers on the ground, in m.")
]
Reference = Annotated[str | None, Option(metavar="SENSOR", help="Sensor whose stamps define the frames.")]
TimeoutMs = Annotated[
    float | None,
    Option(
        metavar="MS", min=0, help="How long a frame waits for its sensors, in ms (default: as the log says, else 30)."
    ),
]
ToleranceMs = Annotated[
    float | None,
    Option(metavar="MS", min=0, help="Maximum distance of a stamp from the frame's instant, in ms (default: 50)."),
]
MaxGapS = Annotated[float | None, Option(metavar="S", min=0, help="Gap that starts a new segment, in s (default: 2).")]
From = Annotated[
    str | None, Option("--from", metavar="T", help="Start: seconds after the first measurement, or a stamp 'Nns'.")
]
To = Annotated[str | None, Option(metavar="T", help="End (excluded).")]
Frames = Annotated[str | None, Option(metavar="A:B", help="Frame indices, B excluded.")]
Topics = Annotated[
    list[str] | None,
    Option(metavar="PATTERN", help="Read only these topics or sensors ('!PATTERN' excludes); repeatable."),
]
Sensors = Annotated[
    list[str] | None,
    Option(metavar="PATTERN", help="Give the pipeline only these sensors ('!PATTERN' excludes); repeatable."),
]
Offset = Annotated[
    list[str] | None, Option(metavar="SENSOR=MS", help="Offset added to the stamps of a sensor; repeatable.")
]
Stamps = Annotated[
    str | None,
    Option(metavar="SOURCE", help="Use the stamps of the 'header' (default), or the recording times of the 'log'."),
]
Condition = Annotated[
    str,
    Option(
        metavar="NAME:LEVEL",
        help="Disturb the messages: fog:3, rain:25mmh+night, loss.radar:1 or fog@5s-8s, or a TOML file; see fbench "
        "plugins conditions.",
    ),
]
Seed = Annotated[int, Option(metavar="N", help="Random seed of conditions, and of latency from a profile.")]
BudgetMs = Annotated[
    float, Option(metavar="MS", help="Time that a frame may take; in a sweep, counted from when it was ready.")
]
Overlap = Annotated[
    int,
    Option(
        metavar="N",
        help="Detect in several frames at the same time, in N processes, where the pipeline allows it. The results are "
        "the same.",
    ),
]
ReadAhead = Annotated[str, Option(metavar="N", help="Number of messages to decode in advance, 'all', or 'auto'.")]
InterpolateTruthMs = Annotated[
    float,
    Option(
        "--interpolate-truth",
        metavar="MS",
        min=0,
        help="Interpolate truth for frames without truth, between truths that are at most this far apart, in ms; "
        "0: don't.",
    ),
]
MinCoverage = Annotated[
    float, Option(metavar="SHARE", min=0, max=1, help="Exit with 1 if a smaller share of outputs has truth.")
]
NoMedia = Annotated[bool, Option("--no-media", help="Keep images and points out of the run.")]
Redact = Annotated[
    bool, Option("--redact", help="Also leave out log and file names, paths, poses, and the places of faults.")
]
Jobs = Annotated[
    int | None,
    Option(metavar="N", min=1, max=1024, help="Processes at a time (default: one a core); results don't depend on it."),
]
Iou = Annotated[float, Option(metavar="SHARE", min=0, max=1, help="2D match: minimum overlap (IoU).")]
Config = Annotated[
    str | None,
    Option(metavar="FILE", help="Configuration file (default: fbench.toml beside the log); 'none' uses none."),
]
RigFiles = Annotated[
    list[Path] | None, Option(metavar="FILE", help="Calibration: TOML, URDF, Kalibr or camera_info YAML; repeatable.")
]
Decoders = Annotated[
    list[str] | None,
    Option(
        "--decoder",
        metavar="NAME",
        help="Decoder of messages that fbench doesn't know: FILE.py:FUNCTION or a plug-in; repeatable.",
    ),
]
TruthFile = Annotated[Path | None, Option(metavar="PATH", help="Ground truth from this file or folder.")]
TruthFormat = Annotated[str | None, Option(metavar="FORMAT", help="Format of --truth if its content doesn't show it.")]
TruthFrame = Annotated[
    str, Option(metavar="NAME", help="Coordinate frame or camera of --truth if the file doesn't name it.")
]
DetectionsFile = Annotated[
    Path | None, Option(metavar="PATH", help="Score these results of another system, from a file or folder.")
]
PipelineOrFile = Annotated[
    str | None,
    Option(
        "--pipeline", "-p", metavar="NAME",
        help="A name (see fbench plugins), FILE.py:CLASS, FILE.toml, recorded:TOPIC or 'exec:COMMAND'.",
    ),
]  # fmt: skip
Device = Annotated[
    Literal["cpu", "cuda"], Option(help="Where networks run; 'cuda' is an NVIDIA GPU, see docs/learned.md.")
]
Isolate = Annotated[
    bool, Option("--isolate", help="Run the pipeline in a process of its own, so that a crash costs only a frame.")
]
FrameTimeoutS = Annotated[
    float, Option(metavar="S", min=0.001, help="With --isolate: a frame that takes longer fails, in s.")
]
DetectEvery = Annotated[
    int | None,
    Option(metavar="N", min=1, help="Run detection on every N-th frame only, and predict tracks in between."),
]
Latency = Annotated[
    str | None,
    Option(
        metavar="HOW",
        help="Frames that come while the pipeline works wait or are dropped, and outputs count from when they are "
        "ready: 'measured', a time such as 'fixed:80ms', or 'profile:FILE' of fbench profile.",
    ),
]
Overload = Annotated[
    str | None,
    Option(metavar="HOW", help="With --latency: 'newest' waits (the default), 'fifo:N' wait, or 'skip'."),
]


def box_source(path: Path | None, form: str | None, frame: str) -> "BoxSource | None":
    """Return a file of boxes as the command line names it; `frame` is the camera too, where there are 2D boxes."""
    from fbench.replay.logs.setup import BoxSource

    return None if path is None else BoxSource(path, form, frame, frame)


_EXAMPLES: Mapping[str, tuple[str, ...]] = {
    "demo": ("fbench demo", "fbench demo --out /tmp/demo", "fbench demo --split test -o runs/suite"),
    "init": ("fbench init log.mcap", "fbench init log.mcap -o configs/car.toml --overwrite"),
    "replay": (
        "fbench replay log.mcap --pipeline lidar3d",
        "fbench replay log.mcap -p late3d --set camera.weights=yolox.onnx --rate 2 -o runs/mine --report",
        "fbench replay log.mcap -p my_pipeline.py:MyPipeline",
        "fbench replay log.mcap -p 'exec:./my_stack --fast' --truth labels.csv",
        "fbench replay log.mcap -p recorded:/perception/tracks",
        "fbench replay log.mcap -p radar3d --decoder acme.py:targets",
        "fbench replay log.mcap -p late3d --condition fog:3+dropout.radar:1 --seed 4",
    ),
    "score": (
        "fbench score runs/log-lidar3d",
        "fbench score runs/log-lidar3d --range-m 80 --all-around",
        "fbench score runs/log-lidar3d --truth label_02/0003.txt",
        "fbench score runs/log-lidar3d --explain 12",
        "fbench score runs/city1-late3d runs/city2-late3d --intervals 1000 -o together.json",
        "fbench score runs/log-lidar3d --profile kitti-3dmot --match iou3d:0.25",
        "fbench score --truth label_02 --detections tracker/data --profile trackeval-kitti -o scores.json",
        "fbench score --truth MOT17/train --detections results --profile trackeval-mot --sequences MOT17-02,MOT17-04",
        "fbench score --truth truth.json --detections submission.json --profile nuscenes-detection --json",
    ),
    "report": (
        "fbench report runs/log-lidar3d",
        "fbench report runs/log-lidar3d runs/log-late3d -o both.html",
        "fbench report runs/log-late3d --base baseline.json",
        "fbench report runs/log-late3d --overlay overlay.mcap --log log.mcap",
        "fbench report runs/log-late3d --tables tables --figures figures",
    ),
    "view": ("fbench view runs/log-late3d", "fbench view runs/log-lidar3d runs/log-late3d --port 8000"),
    "compare": (
        "fbench compare runs/base runs/head",
        "fbench compare runs/base runs/head --tolerance 0.01",
        "fbench compare runs/base runs/head --report runs/comparison.html",
        "fbench compare main-suite branch-suite --policy gate.toml --write junit=gate.xml",
        "fbench compare baseline.json runs/head --policy gate.toml",
    ),
    "baseline accept": ("fbench baseline accept runs/head --reason 'new tracker' -o baseline.json",),
    "bench": (
        "fbench bench suite.toml",
        "fbench bench suite.toml --jobs 4 -o runs/nightly --json",
        "fbench bench suite.toml --leave-one-out",
        "fbench bench suite.toml --scheduler tcp://10.0.0.1:8786 --store s3://lab/results",
    ),
    "bench init": (
        "fbench bench init drives/*.mcap",
        "fbench bench init log.mcap -p late3d,lidar3d --condition fog --condition rain:5 -o suites/weather.toml",
    ),
    "robust": (
        "fbench robust log.mcap -p late3d,lidar3d",
        "fbench robust log.mcap -p late3d --suite faults --severity 3",
        "fbench robust a.mcap b.mcap -p late3d -p radar3d --condition fog:150m --condition dropout.lidar -o runs/mine",
    ),
    "profile": (
        "fbench profile log.mcap -p late3d -o orin.json",
        "fbench replay log.mcap -p late3d --latency profile:orin.json",
    ),
    "sweep": ("fbench sweep runs/demo/city.mcap -p lidar3d --latency fixed:80ms --rates 0.5,1,2",),
    "verify": (
        "fbench verify log.mcap -p lidar3d",
        "fbench verify log.mcap -p my_pipeline.py:MyPipeline --quick --repeat 3 --frames :50",
        "fbench verify log.mcap -p late3d --latency fixed:80ms --quick",
    ),
    "plugins": (
        "fbench plugins",
        "fbench plugins pipelines late3d",
        "fbench plugins decoders",
        "fbench plugins conditions lidar.fog",
        "fbench plugins metrics hota",
        "fbench plugins profiles kitti-3dmot",
    ),
    "log info": ("fbench log info log.mcap", "fbench log info log.mcap --json"),
    "log check": (
        "fbench log check log.mcap",
        "fbench log check log.mcap -p late3d --timeout-ms 50",
        "fbench log check log.mcap --ignore LOG006 --json",
    ),
    "log preview": (
        "fbench log preview log.mcap",
        "fbench log preview log.mcap -o pictures --frames 100:200 --num 4",
        "fbench log preview log.mcap --condition rain:4 -o rain",
        "fbench log preview log.bag --offset lidar=-50 --topics '!rear*' --overwrite",
    ),
    "log convert": (
        "fbench log convert drive.mcap -o drive.parquet",
        "fbench log convert drive.bag -o part.mcap --from 12.5 --to 20 --topics '/lidar*'",
        "fbench log convert drive.mcap -o drive --split-s 60",
        "fbench log convert drive.mcap -o foggy.mcap --condition fog:3",
    ),
    "log import": (
        "fbench log import astyx path/to/astyx -o astyx.mcap",
        "fbench log import nuscenes path/to/nuscenes -o logs --scenes 'scene-01*' --skip-bad",
        "fbench log import kitti path/to/tracking -o 0012.mcap --scenes 0012 --detections results",
    ),
    "log export": (
        "fbench log export runs/0003-lidar3d --format kitti-tracking --class Car -o results/data",
        "fbench log export kitti/0000.mcap kitti/0001.mcap --format kitti-tracking -o label_02",
        "fbench log export runs/scene-*-late3d --format nuscenes -o submission.json",
    ),
    "log simulate": (
        "fbench log simulate urban --condition fog --seconds 10 --seed 3 -o fog.mcap",
        "fbench log simulate highway --sensors 'lidar,radar' --set weather.rain_mm_h=30 -o rain.mcap",
        "fbench log simulate suite --split test -o suite",
    ),
    "weights compare": ("fbench weights compare drive.mcap deimv2-femto yolox-nano mine.onnx",),
    "weights list": ("fbench weights list", "fbench weights list --json"),
    "weights get": (
        "fbench weights get deimv2-femto",
        "fbench weights get yolox-tiny --from downloads/yolox_tiny.onnx",
        "fbench replay log.mcap -p late3d --set camera.weights=deimv2-femto",
    ),
    "weights train": (
        "fbench log simulate training -o training",
        "fbench weights train training -o city.onnx",
        "fbench log simulate training-points -o points",
        "fbench weights train my-logs points --model learned3d --weights auto -o own.onnx",
        "fbench replay log.mcap -p camera2d --set camera.weights=city.onnx",
    ),
}


def examples(command: str) -> str:
    """Return the examples of a command, such as `log info`, as its help shows them."""
    return "\n\n".join(["[bold]Examples[/bold]", *_EXAMPLES[command]])
