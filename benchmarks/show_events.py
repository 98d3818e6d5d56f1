"""Count the events of traffic in logs with truth and poses, time the finder, and draw one of each from above.

Run it from the root of the repository: `python benchmarks/show_events.py LOG ... [--draw OUT.png]`. For the picture in
`docs/metrics.md`: the city with `--sensors radar`, 20 s each, `urban` with seeds 101 to 104 and `highway` with 105.
"""

import argparse
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from fbench.metrics.criticality.motion import EgoMotion, follow_ego
from fbench.metrics.events.finder import EVENTS, Found, find_events
from fbench.metrics.events.scores import count_stretches
from fbench.metrics.profiles.nuscenes.boxes import solids
from fbench.metrics.runs.columns import objects_of
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Array
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Pose
from fbench.replay.data.sequences import Objects, Steps
from fbench.replay.logs.open import open_log

_SIZE, _SCALE, _GRAY, _RED, _BLUE = 330, 3.6, (150, 150, 150), (40, 40, 220), (200, 110, 20)
_MAX_POSE_NS = 50_000_000
_NEAR_M = 45.0  # What is farther isn't in the picture


class Drive(NamedTuple):
    """Truth of one log, frame by frame, and how the ego moves."""

    name: str
    truth: Objects
    steps: Steps
    ego: EgoMotion


def read_drive(path: Path) -> Drive:
    """Read truth in 3D, and at each instant of it the nearest pose."""
    log = open_log(path, FaultLog())
    poses = [m for m in log.messages() if isinstance(m, Pose)]
    truths = [t for t in log.truths() if t.boxes3d is not None]
    if not poses or not truths:
        raise SystemExit(f"{path}: needs poses and truth in 3D")
    pose_ns = np.array([p.stamp_ns for p in poses])
    stamp_ns = np.array([t.stamp_ns for t in truths])
    rows = [np.r_[p.translation_m, p.rotation_xyzw] for p in poses]
    nearest = np.array([np.abs(pose_ns - stamp).argmin() for stamp in stamp_ns])
    own = np.array(rows)[nearest]
    own[np.abs(pose_ns[nearest] - stamp_ns) > _MAX_POSE_NS] = np.nan
    index, zeros = np.arange(len(truths)), np.zeros(len(truths), np.int64)
    parts = [
        objects_of(t.boxes3d, np.full(len(t.boxes3d), i), np.ones(len(t.boxes3d), bool))
        for i, t in enumerate(truths)
        if isinstance(t.boxes3d, Boxes3D)
    ]
    names = [name for name in parts[0].arrays() if all(name in part.arrays() for part in parts)]
    truth = Objects(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})
    return Drive(path.stem, truth, Steps(index, stamp_ns, zeros), follow_ego(index, zeros, stamp_ns, own))


def draw(drive: Drive, found: Found, event: str) -> Array | None:
    """Draw the longest of an event: the ego's path, the object's (red) and all other truth (gray), in the ego's axes at
    its middle; `None` where there is none.
    """
    truth, ids, (center_m, size_lwh_m, yaw_rad) = drive.truth, drive.truth.track_id, solids(drive.truth)
    far = np.hypot(*center_m[:, :2].T)
    own = np.flatnonzero(found.rows[event] & (far <= _NEAR_M))
    if not len(own):
        return None
    number = Counter(ids[own].tolist()).most_common(1)[0][0]
    own = own[ids[own] == number]
    middle = int(truth.step[own[len(own) // 2]])
    picture = np.full((_SIZE, _SIZE, 3), 255, np.uint8)
    turn, origin = np.exp(1j * drive.ego.yaw_rad), drive.ego.place[middle]

    def pixels(world: Array) -> Array:
        local = (world - origin) * np.conj(turn[middle])
        return np.stack([_SIZE / 2 - _SCALE * local.imag, _SIZE * 0.8 - _SCALE * local.real], axis=-1).astype(np.int32)

    def corners(row: int, step: int) -> Array:
        length, width, _ = size_lwh_m[row] / 2
        place = complex(*center_m[row, :2])
        box = np.array([length + 1j * width, length - 1j * width, -length - 1j * width, -length + 1j * width])
        world: Array = drive.ego.place[step] + (place + box * np.exp(1j * yaw_rad[row])) * turn[step]
        return world

    cv2.polylines(picture, [pixels(drive.ego.place)], False, _BLUE, 1, cv2.LINE_AA)
    body = np.array([3.7 + 0.9j, 3.7 - 0.9j, -1 - 0.9j, -1 + 0.9j])
    cv2.fillPoly(picture, [pixels(origin + body * turn[middle])], _BLUE, cv2.LINE_AA)
    for row in np.flatnonzero(truth.step == middle).tolist():
        color = _RED if ids[row] == number else _GRAY
        cv2.fillPoly(picture, [pixels(corners(row, middle))], color, cv2.LINE_AA)
    of = np.flatnonzero(ids == number)
    world = drive.ego.place[truth.step[of]] + (center_m[of, 0] + 1j * center_m[of, 1]) * turn[truth.step[of]]
    cv2.polylines(picture, [pixels(world)], False, _RED, 1, cv2.LINE_AA)
    cv2.rectangle(picture, (0, 0), (_SIZE - 1, 22), (255, 255, 255), -1)
    cv2.putText(picture, event, (8, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    cv2.rectangle(picture, (0, 0), (_SIZE - 1, _SIZE - 1), _GRAY, 1)
    return picture


def main() -> None:
    """Print counts and times; draw."""
    parser = argparse.ArgumentParser()
    parser.add_argument("logs", nargs="+", type=Path)
    parser.add_argument("--draw", type=Path)
    arguments = parser.parse_args()
    best: dict[str, tuple[int, Array]] = {}
    print("log", "frames", "boxes a frame", *EVENTS, "ms a frame", sep="; ")
    for path in arguments.logs:
        drive = read_drive(path)
        begin = time.perf_counter()
        found = find_events(drive.truth, drive.steps, drive.ego)
        ms = 1e3 * (time.perf_counter() - begin) / len(drive.steps)
        nums = [count_stretches(drive.truth, np.flatnonzero(found.rows[name]), drive.steps) for name in EVENTS]
        boxes = len(drive.truth) / len(drive.steps)
        print(drive.name, len(drive.steps), f"{boxes:.0f}", *nums, f"{ms:.2f}", sep="; ")
        for name in EVENTS if arguments.draw else ():
            picture, size = draw(drive, found, name), int(found.rows[name].sum())
            if picture is not None and size > best.get(name, (0, None))[0]:
                best[name] = size, picture
    if arguments.draw and best:
        pictures = [best[name][1] for name in EVENTS if name in best]
        pictures += [np.full_like(pictures[0], 255)] * (-len(pictures) % 3)
        rows = [np.hstack(pictures[i : i + 3]) for i in range(0, len(pictures), 3)]
        cv2.imwrite(str(arguments.draw), np.vstack(rows))


if __name__ == "__main__":
    main()
