"""Ten planted regressions on a log of the city: are they found, with labels and without?

    python benchmarks/bench_planted.py FOLDER [--seconds 20] [--seed 3]

FOLDER keeps the log and the runs; a second call only compares. Of each regression is printed, with labels: the verdict
by one policy for all (`POLICY`), which of the gates failed, the first stage and frame that differ, the slices that
REGRESSED, and the frames of the object that was lost for longest. Without labels: how many changes of objects were
found, how many of the first 1 % (at least one) are worse by the truth that the comparison didn't see, and how many of
all. A change is worse where in most of its frames the base was right (a truth object within 2 m) and the head not:
LOST, nothing of the head is within 2 m of that object; FOUND, nothing true is within 2 m; NEW SWITCH, the base has one
track before and after on an object, and the head another than before.
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the small city of the tests

from tests.city_log import write_city_log

from fbench.api import LogRequest, ReplayRequest, replay
from fbench.api.gates import CompareRequest, compare_sides
from fbench.metrics.comparison.reference import rank_changes
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.comparison import Comparison, ObjectChange
from fbench.replay.runs.folder import Run
from fbench.replay.runs.tables import read_boxes

POLICY = """version = 1
[[gate]]
metric = "f1"
[[gate]]
metric = "mota"
[[gate]]
metric = "mota_no_fp"
[[gate]]
metric = "motp"
kind = "absolute"
tolerance = 0.1
"""
NEAR_M = 2.0


@dataclass(frozen=True)
class Planted:
    """What is made worse, and where the comparison must find it."""

    stage: str
    settings: tuple[str, ...] = ()
    condition: str = ""
    pipeline: str = "lidar3d"


_NARROW = ("tracking.association=distance", "tracking.gate_m=0.05", "tracking.gate_mps=0")
PLANTED = {
    "small radius": Planted("lidar", ("lidar.cluster.eps_m=0.12",)),
    "large radius": Planted("lidar", ("lidar.cluster.eps_m=3",)),
    "many points": Planted("lidar", ("lidar.cluster.min_points=30",)),
    "short range": Planted("lidar", ("lidar.max_range_m=20",)),
    "high ground": Planted("lidar", ("lidar.ground.tolerance_m=1.2",)),
    "sure fusion": Planted("fuse", ("fusion.min_score=0.9",), pipeline="late3d"),
    "narrow gate": Planted("track", _NARROW),
    "late tracks": Planted("track", ("tracking.min_hits=12",)),
    "shifted calibration": Planted("lidar", condition="extrinsic.lidar:5"),
    "dropped sensor": Planted("frames", condition="loss.lidar:4"),
}
UNCHANGED = {"nothing": Planted(""), "other bits": Planted("", ("lidar.cluster.eps_m=0.61",))}


def replay_into(folder: Path, name: str, planted: Planted) -> Path:
    """Replay, unless the run is there."""
    out = folder / name.replace(" ", "-")
    if not out.is_dir():
        log = LogRequest(folder / "city.mcap")
        request = ReplayRequest(
            log, planted.pipeline, planted.settings, condition=planted.condition, out=out, no_media=True
        )
        replay(request)
    return out


class Positions:
    """Where the boxes of a run are, by frame: (N, 2) [m], with ids."""

    def __init__(self, path: Path) -> None:
        held = read_boxes(path)
        assert isinstance(held.boxes, Boxes3D)
        self._frames, self._xy = held.frames, held.boxes.center_m[:, :2]
        self._ids = held.boxes.track_id if held.boxes.track_id is not None else np.full(len(self._xy), -1)

    def at(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Return places and ids."""
        rows = self._frames == frame
        return self._xy[rows], self._ids[rows]

    def near(self, frame: int, place: np.ndarray) -> int | None:
        """Return the id of the nearest within `NEAR_M`; `None`: there is none."""
        xy, ids = self.at(frame)
        away = np.hypot(*(xy - place).T) if len(xy) else np.zeros(0)
        return int(ids[away.argmin()]) if len(away) and away.min() <= NEAR_M else None


@dataclass(frozen=True)
class Truth:
    """Base, head and truth, to say whether a change is for the worse."""

    base: Positions
    head: Positions
    truth: Positions

    def is_worse(self, change: ObjectChange) -> bool:
        """Tell it of one change, by most of its frames."""
        side = self.head if change.kind == "FOUND" else self.base
        votes = list[bool]()
        for frame in range(change.frames[0], change.frames[1] + 1):
            xy, ids = side.at(frame)
            votes += [self._is_worse(change.kind, frame, place) for place in xy[ids == change.track_id]]
        return sum(votes) * 2 > len(votes)

    def _is_worse(self, kind: str, frame: int, place: np.ndarray) -> bool:
        true = self.truth.near(frame, place)
        if kind == "FOUND":
            return true is None
        if true is None:
            return False
        xy, ids = self.truth.at(frame)
        object_xy = xy[ids == true][0]
        now = self.head.near(frame, object_xy)
        if kind == "LOST":
            return now is None
        before = self._last(frame, true)
        return before is not None and now is not None and before != now

    def _last(self, frame: int, true: int) -> int | None:
        for earlier in range(frame - 1, max(frame - 10, -1), -1):
            xy, ids = self.truth.at(earlier)
            if (ids == true).any() and (found := self.head.near(earlier, xy[ids == true][0])) is not None:
                return found
        return None


def show_labeled(name: str, found: Comparison, stage: str) -> bool:
    """Print what the comparison with labels says; return whether it is found at its stage."""
    bad = [row for row in found.rows if row.verdict == "REGRESSED"]
    first = found.divergences[0] if found.divergences else None
    gates = ", ".join(f"{row.metric} {row.delta:+.2f}" for row in bad if row.gate and row.delta is not None)
    slices = sorted({row.slice for row in bad if row.slice.startswith(("range", "visibility"))})
    lost = f"#{found.objects[0].track_id} frames {found.objects[0].frames}" if found.objects else "-"
    where = f"{first.stage} at frame {first.frame}" if first else "nowhere"
    print(f"{name}: {found.state} ({gates or 'no gate'}); {where}; {'; '.join(slices[:4]) or 'no slice'}; {lost}")
    return found.state == "failed" and any(row.gate for row in bad) and first is not None and first.stage == stage


def show_unlabeled(name: str, base: Path, head: Path) -> bool:
    """Print how many of the changes that come first are worse; return whether any is."""
    changes = rank_changes(Run(base), Run(head))
    truth = Truth(
        *(Positions(path) for path in (base / "tracks.parquet", head / "tracks.parquet", base / "truth.parquet"))
    )
    worse = [truth.is_worse(change) for change in changes]
    few = max(1, len(changes) // 100)
    print(f"{name}, without labels: {len(changes)} changes, {sum(worse[:few])} of the first {few} are worse, "
          f"{100 * np.mean(worse or [False]):.0f} % of all; {changes[0] if changes else '-'}")  # fmt: skip
    return any(worse[:few])


def main() -> None:
    """Replay what isn't there, compare, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=3)
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    if not (args.folder / "city.mcap").exists():
        write_city_log(args.folder / "city.mcap", args.seconds, args.seed)
    policy = args.folder / "gate.toml"
    policy.write_text(POLICY, encoding="utf-8")
    labeled = unlabeled = 0
    for name, planted in {**PLANTED, **UNCHANGED}.items():
        base = replay_into(args.folder, f"base {planted.pipeline}", Planted("", pipeline=planted.pipeline))
        head = replay_into(args.folder, name, planted)
        is_found = show_labeled(name, compare_sides(CompareRequest(base, head, 0.0, policy)), planted.stage)
        if name in PLANTED:
            labeled += is_found
            unlabeled += show_unlabeled(name, base, head)
    print(f"found with labels: {labeled} of {len(PLANTED)}; among the first 1 % without: {unlabeled}")


if __name__ == "__main__":
    main()
