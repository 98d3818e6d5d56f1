"""Early against late fusion over growing errors of mounting and of time: F1, and where the curves cross.

    python benchmarks/bench_calibration_errors.py [--seconds S] [--seeds N ...] [--pipelines NAME ...] [--out FOLDER]

Drives of both worlds in clear weather, with the thesis's mono camera, radar and LiDAR (10 turns a second here). Errors
of mounting: the pipelines are told a wrong pose of camera and radar, T exp(xi) with a random axis and direction, the
same for the whole drive and for all pipelines. Errors of time: the camera's images are older than their stamps say.

A short version by default; --seconds 5 --seeds 101 102 runs five times as long.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from common import write_missing
from scipy.spatial.transform import Rotation

from fbench.api.replays import replay
from fbench.datasets.city.recording import CityRecording
from fbench.datasets.city.rig import RigSpec, thesis_rig
from fbench.datasets.city.spec import CitySpec, WorldName, condition
from fbench.metrics.robustness.scenes import ScoredRun, pool
from fbench.replay.conditions.generators import generator
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import NO_CONFIG, LogRequest

WORLDS: tuple[WorldName, ...] = ("urban", "highway")
MOUNTING = ((0.0, 0.0), (0.25, 0.02), (0.5, 0.05), (1.0, 0.10), (2.0, 0.20), (3.0, 0.50))
"""Angles [deg] and distances [m]."""
LATE_MS = (0, 20, 50, 100, 200)
PERIOD_MS = 100
PATIENCE_MS = 1000.0
"""Frames wait so long for an image: one that is older than its stamp also arrives later than that says."""
WRONG = ("camera", "radar")
PAIRS = (("early2d", "late2d", "image"), ("early3d", "late3d", "3D"), ("early3d", "late3d", "image"))


@dataclass(frozen=True)
class Drive:
    """One scene."""

    world: WorldName
    seed: int
    seconds: float

    def recording(self, late_ms: int) -> CityRecording:
        """With a camera that measures so long after the LiDAR."""
        rig = thesis_rig()
        camera = rig.cameras["camera"].model_copy(update={"phase_ms": float(late_ms % PERIOD_MS)})
        lidar = rig.lidars["lidar"]
        lidar = lidar.model_copy(update={"rate_hz": 1000.0 / PERIOD_MS, "points_per_s": lidar.points_per_s // 2})
        own = RigSpec(cameras={"camera": camera}, lidars={"lidar": lidar}, radars=rig.radars)
        spec = CitySpec(self.world, condition("clear"), self.seconds, self.seed, own)
        return CityRecording(spec, f"{self.world}-{self.seed}-{late_ms % PERIOD_MS}")

    def log(self, folder: Path, late_ms: int) -> Path:
        """Its file, written where it isn't there."""
        recording = self.recording(late_ms)
        return write_missing(recording, folder / f"{recording.name}.mcap")


def wrong_rig(drive: Drive, degrees: float, meters: float) -> str:
    """Calibration with an error xi of camera and radar, as TOML."""
    rig, lines = drive.recording(0).rig, []
    for name in WRONG:
        draw = generator(drive.seed, "mounting", drive.world, name)
        axis, direction = (v / np.linalg.norm(v) for v in draw.normal(size=(2, 3)))
        error = np.eye(4)
        error[:3, :3] = Rotation.from_rotvec(np.radians(degrees) * axis).as_matrix()
        error[:3, 3] = meters * direction
        lines += [f"[sensors.{name}]", f"matrix = {(rig.body_T_sensor(name) @ error).tolist()}"]
    return "\n".join(lines) + "\n"


def run(drive: Drive, pipeline: str, level: str, log: LogRequest, offset: Sequence[str], folder: Path) -> ScoredRun:
    """Replay one drive with one error."""
    out = folder / f"{drive.world}-{drive.seed}-{level}-{pipeline}"
    request = ReplayRequest(
        log, pipeline, reference="lidar", timeout_ms=PATIENCE_MS, offset=offset, interpolate_truth_ms=2 * PERIOD_MS,
        out=out, overwrite=True, no_media=True,
    )  # fmt: skip
    return ScoredRun(pipeline, level, f"{drive.world}-{drive.seed}", replay(request).run.scores)


def mounting(drives: Sequence[Drive], pipelines: Sequence[str], folder: Path) -> Iterator[ScoredRun]:
    """Yield the runs with growing errors of mounting."""
    for drive in drives:
        for degrees, meters in MOUNTING:
            file = folder / f"{drive.world}-{drive.seed}-{degrees}.toml"
            file.write_text(wrong_rig(drive, degrees, meters))
            log = LogRequest(drive.log(folder, 0), NO_CONFIG, [file])
            for pipeline in pipelines:
                yield run(drive, pipeline, f"{degrees:g} deg, {100 * meters:g} cm", log, (), folder)


def late(drives: Sequence[Drive], pipelines: Sequence[str], folder: Path) -> Iterator[ScoredRun]:
    """Yield the runs with growing errors of time."""
    for drive in drives:
        for late_ms in LATE_MS:
            log, offset = LogRequest(drive.log(folder, late_ms), NO_CONFIG), [f"camera={-late_ms}"] if late_ms else []
            for pipeline in pipelines:
                yield run(drive, pipeline, f"{late_ms} ms", log, offset, folder)


def table(title: str, runs: Sequence[ScoredRun], levels: Sequence[float]) -> None:
    """Print F1 by level, and where early and late fusion cross."""
    names = list(dict.fromkeys(r.condition for r in runs))
    pipelines = list(dict.fromkeys(r.configuration for r in runs))
    sys.stdout.write(f"\n| {title} | space | {' | '.join(names)} |\n|---|---|{'---:|' * len(names)}\n")
    found: dict[tuple[str, str], list[float | None]] = {}
    for space in ("image", "3D"):
        for pipeline in pipelines:
            own = [[r for r in runs if (r.configuration, r.condition) == (pipeline, name)] for name in names]
            values = [pool(members, "f1", space).value for members in own]
            if any(value is not None for value in values):
                found[pipeline, space] = values
                shown = " | ".join("-" if value is None else f"{100 * value:.1f}" for value in values)
                sys.stdout.write(f"| {pipeline} | {space} | {shown} |\n")
    for early, late_, space in PAIRS:
        if (early, space) in found and (late_, space) in found:
            both = zip(found[early, space], found[late_, space], strict=True)
            lead = [float("nan") if a is None or b is None else b - a for a, b in both]
            places = [  # where the better one changes, by straight lines between the levels measured
                x + (y - x) * a / (a - b)
                for (x, y), (a, b) in zip(pairwise(levels), pairwise(lead), strict=True)
                if a * b < 0
            ]
            where = f"cross at {', '.join(f'{place:.2g}' for place in places)}" if places else "never cross"
            begins = f"{late_ if lead[0] > 0 else early} is ahead without errors"
            sys.stdout.write(f"\n{early} and {late_}, {space}: {begins}; they {where}\n")


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--seeds", type=int, nargs="+", default=[101])
    parser.add_argument("--pipelines", nargs="+", default=["early2d", "late2d", "early3d", "late3d", "lidar3d"])
    parser.add_argument("--out", type=Path, help="folder for logs and runs that stay; else they are removed")
    args = parser.parse_args()
    drives = [Drive(world, seed, args.seconds) for seed in args.seeds for world in WORLDS]
    with tempfile.TemporaryDirectory() as made:
        folder = args.out or Path(made)
        folder.mkdir(parents=True, exist_ok=True)
        table("F1 %, wrong mounting", list(mounting(drives, args.pipelines, folder)), [d for d, _ in MOUNTING])
        table("F1 %, camera late", list(late(drives, args.pipelines, folder)), [float(ms) for ms in LATE_MS])


if __name__ == "__main__":
    main()
