"""F1 on stretches of Astyx HiRes 2019, or whole sets, that are left out in turn while others choose the parameters.

    python benchmarks/bench_leave_out.py FOLDER [FOLDER ...] --weights FILE.onnx [--pipelines NAME,NAME]
    python benchmarks/bench_leave_out.py FOLDER [FOLDER ...] --weights FILE.onnx --sets [NAME=LOG ...]

Each run of consecutive frames in the folders is a stretch, and becomes a log of its own. For pipelines with
`CANDIDATES`, each stretch is scored with those settings that are best on all others. Prints tables in Markdown: F1 over
all stretches with 95% intervals (2,000 resamples of the stretches), and by how much each fusion is ahead of the best of
its inputs.

With `--sets`, the folders' stretches together are one set, each named log is another, and so is each of `LIDARS` in the
simulated city. Each set is scored with the judge of LiDAR clusters that has the best mean F1 over all other sets.
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from common import write_missing

from fbench.api.replays import replay
from fbench.datasets.city.recording import CityRecording
from fbench.datasets.city.rig import CameraSpec, LidarSpec, RadarSpec, RigSpec
from fbench.datasets.city.spec import CitySpec, WorldName
from fbench.replay.data.arrays import Float64
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import LogRequest

INPUTS = {
    "camera2d": (), "lidar2d": (), "radar2d": (), "early2d": ("camera2d", "lidar2d", "radar2d"),
    "late2d": ("camera2d", "lidar2d", "radar2d"), "lidar3d": (), "radar3d": (), "early3d": ("lidar3d", "radar3d"),
    "late3d": ("lidar3d", "radar3d"),
}  # fmt: skip
"""Pipelines, and for fusions those that use one of their sensors in the same dimension."""
_ASSOCIATION = "fusion.association."
_OLD = (
    f"{_ASSOCIATION}tilt_std_rad=0.004", f"{_ASSOCIATION}lidar_area_m2=100", "fusion.lidar_half_m=40",
    "fusion.agreement.radar=0.4",
)  # fmt: skip
CANDIDATES: Mapping[str, Sequence[tuple[str, ...]]] = {
    "late3d": (
        (),
        ("fusion.lidar_weight=0.35",),
        ("fusion.lidar_weight=0.65",),
        _OLD,
        *((*_OLD[:at], *_OLD[at + 1 :]) for at in range(len(_OLD))),
    ),
    "early2d": (
        (), ("fusion.measured_share=0",), ("fusion.measured_share=0.2",), ("fusion.most_unseen=2",),
        ("fusion.outline=points",),
    ),
    "late2d": ((), ("fusion.measured_share=0",), ("fusion.measured_share=0.2",)),
}  # fmt: skip
"""Settings to choose from: the defaults, those of earlier versions, and what lies between."""
RESAMPLES = 2000
JUDGES = (("lidar.judge=model",), ("lidar.judge=both",), ("lidar.judge=rules",))
WORLDS: tuple[WorldName, ...] = ("urban", "highway")
SEED, SECONDS, RATE_HZ = 103, 4.0, 5.0  # A development seed on which the model of clusters wasn't fitted
_BEAMS = {16: (15.0, -15.0, 150_000), 32: (10.0, -30.0, 350_000), 64: (2.0, -24.8, 650_000),
          128: (15.0, -25.0, 1_200_000)}  # fmt: skip
LIDARS = {
    f"{name}{num}": LidarSpec(translation_m=at, rate_hz=RATE_HZ, channels=num, points_per_s=shots, upper_deg=upper,
                              lower_deg=lower, noise_m=0.02)
    for num, (upper, lower, shots) in _BEAMS.items()
    for name, at in (("roof", (0.0, 0.0, 1.9)), ("bumper", (2.2, 0.0, 0.6)))
}  # fmt: skip
"""Such as Velodyne's of as many beams, on the roof and on the bumper. The model was fitted on other mounts."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--weights", type=Path, required=True)
    parser.add_argument("--pipelines")
    parser.add_argument("--sets", nargs="*", metavar="NAME=LOG")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        logs = write_stretches(args.folders, Path(temporary))
        if args.sets is not None:
            named = (text.partition("=") for text in args.sets)
            sets = {"Astyx": [(log, ()) for log in logs], **{name: [(Path(log), ())] for name, _, log in named}}
            names = (args.pipelines or "lidar3d,late3d").split(",")
            print_sets({**sets, **write_rigs(Path(temporary))}, names, args.weights)
            return
        counts = {
            name: leave_one_out([
                [count(log, name, settings, args.weights) for log in logs] for settings in CANDIDATES.get(name, ((),))
            ])
            for name in (args.pipelines or ",".join(INPUTS)).split(",")
        }  # fmt: skip
    print(f"{len(logs)} stretches\n\n| pipeline | F1 % | 95% interval | TP | FP | FN | ahead of the best input |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    rows = np.random.Generator(np.random.Philox(0)).integers(0, len(logs), (RESAMPLES, len(logs)))
    for name, own in counts.items():
        sums, values = own.sum(axis=0), 100 * f1(own[rows].sum(axis=1))
        low, high = np.percentile(values, [2.5, 97.5])
        inputs = [counts[other] for other in INPUTS[name] if other in counts]
        ahead = ""
        if inputs:
            best = max(inputs, key=lambda one: float(f1(one.sum(axis=0))))
            difference = values - 100 * f1(best[rows].sum(axis=1))
            least, most = np.percentile(difference, [2.5, 97.5])
            ahead = f"{100 * float(f1(sums) - f1(best.sum(axis=0))):+.1f} ({least:+.1f} to {most:+.1f})"
        print(f"| `{name}` | {100 * f1(sums):.1f} | {low:.1f} to {high:.1f} | {' | '.join(map(str, sums))} | {ahead} |")


def write_stretches(folders: Sequence[Path], out: Path) -> list[Path]:
    """Import each run of consecutive frames as a log."""
    logs = []
    for folder in folders:
        frames = sorted(int(path.stem) for path in (folder / "camera_front").iterdir())
        begins = [frame for frame in frames if frame - 1 not in frames]
        ends = [frame + 1 for frame in frames if frame + 1 not in frames]
        for begin, end in zip(begins, ends, strict=True):
            logs.append(out / f"frames-{begin}.mcap")
            command = ["log", "import", "astyx", str(folder), "-o", str(logs[-1]), "--frames", f"{begin}:{end}"]
            subprocess.run(
                [sys.executable, "-c", "from fbench.cli import main; main()", *command], check=True, capture_output=True
            )
    return logs


def write_rigs(out: Path) -> dict[str, list[tuple[Path, tuple[str, ...]]]]:
    """Simulate a drive of each world with all of `LIDARS`, and return for each the logs and the sensors to use."""
    rig = RigSpec(
        cameras={"camera": CameraSpec(translation_m=(2.0, 0.0, 1.0), rate_hz=RATE_HZ)},
        lidars=LIDARS,
        radars={"radar": RadarSpec(translation_m=(2.0, 0.0, 1.0), yaw_pitch_roll_deg=(0.0, -5.0, 0.0),
                                   rate_hz=RATE_HZ, points_per_s=62_500)},
    )  # fmt: skip
    logs = [out / f"{world}.mcap" for world in WORLDS]
    for world, log in zip(WORLDS, logs, strict=True):
        write_missing(CityRecording(CitySpec(world, seconds=SECONDS, seed=SEED, rig=rig), world), log)
    return {f"city, {name}": [(log, ("camera", "radar", name)) for log in logs] for name in LIDARS}


def print_sets(
    sets: Mapping[str, Sequence[tuple[Path, tuple[str, ...]]]], pipelines: Sequence[str], weights: Path
) -> None:
    """Print for each pipeline and set F1 with the judge that the others choose, with the defaults, and with each."""
    names = [judge.partition("=")[2] for (judge,) in JUDGES]
    print(f"| pipeline | set | chosen on the others | F1 % | with the defaults | {' | '.join(names)} |")
    print(f"|---|---|---|---:|---:|{'---:|' * len(names)}")
    for pipeline in pipelines:
        counts = np.array([
            [sum(count(log, pipeline, judge, weights, sensors) for log, sensors in logs) for logs in sets.values()]
            for judge in ((), *JUDGES)
        ])  # fmt: skip
        usual, values = 100 * f1(counts[0]), 100 * f1(counts[1:])
        chosen = np.argmax((values.sum(axis=1, keepdims=True) - values) / (len(sets) - 1), axis=0)
        own = values[chosen, np.arange(len(sets))]
        for at, name in enumerate(sets):
            row = " | ".join(f"{value:.1f}" for value in (own[at], usual[at], *values[:, at]))
            print(f"| `{pipeline}` | {name} | `{names[chosen[at]]}` | {row} |", flush=True)
        rows = np.random.Generator(np.random.Philox(0)).integers(0, len(sets), (RESAMPLES, len(sets)))
        ends = [np.percentile(part[rows].mean(axis=1), [2.5, 97.5]) for part in (own, usual, *values)]
        columns = zip((own, usual, *values), ends, strict=True)
        means = (f"{part.mean():.1f} ({low:.1f} to {high:.1f})" for part, (low, high) in columns)
        print(f"| `{pipeline}` | mean, 95% interval over sets | | {' | '.join(means)} |", flush=True)


def count(log: Path, pipeline: str, settings: Sequence[str], weights: Path, sensors: Sequence[str] = ()) -> Float64:
    """True positives, false ones, and misses (3,) of a log, by the primary F1; simulated logs have weights of their
    own.
    """
    uses_camera = not pipeline.startswith(("lidar", "radar")) and not sensors
    settings = [*settings, *([f"camera.weights={weights}"] if uses_camera else [])]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        run = replay(ReplayRequest(LogRequest(log), pipeline, settings, sensors=sensors, out=out, no_media=True))
        scores = run.scores()
    counts = scores[(scores["metric"] == "f1") & (scores["slice"] == "all")].iloc[0]["counts"]
    return np.array([counts["tp"], counts["fp"], counts["fn"]])


def leave_one_out(candidates: Sequence[Sequence[Float64]]) -> Float64:
    """Counts (S, 3) of each stretch with the settings that are best on all others; of equal ones the first."""
    table = np.array(candidates)  # (candidates, stretches, counts)
    others = table.sum(axis=1, keepdims=True) - table
    chosen = np.argmax(f1(others), axis=0)
    return np.asarray(table[chosen, np.arange(table.shape[1])])


def f1(counts: Float64) -> Float64:
    """F1 (...) of counts (..., 3)."""
    tp, fp, fn = np.moveaxis(np.asarray(counts, np.float64), -1, 0)
    return np.asarray(2 * tp / np.maximum(2 * tp + fp + fn, 1))


if __name__ == "__main__":
    main()
