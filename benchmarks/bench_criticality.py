"""Time a frame that criticality and events add to scoring: 50 objects and results in each of 200 frames, one process.

Run it from the root of the repository.
"""

import tempfile
import time
from pathlib import Path

import numpy as np
from common import best_by_turns_s

from fbench.metrics.criticality.conflict import find_conflicts
from fbench.metrics.criticality.metric import Criticality, find_critical_errors
from fbench.metrics.criticality.motion import find_ego_motion, move_ego, move_objects
from fbench.metrics.events.metric import Events
from fbench.metrics.runs.detection import Detection
from fbench.metrics.runs.places import SharedRun
from fbench.metrics.runs.spaces import ground_view
from fbench.metrics.runs.tracking import Tracking
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Truth
from fbench.replay.data.metadata import outline_of
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.runs.folder import FrameRecord, RunWriter
from fbench.replay.runs.manifest import FrameEntry, LogEntry, Manifest

_WITHOUT_READING = ("reading", "prediction of what is critical", "critical errors, after it")
NUM_FRAMES, NUM, STEP_NS = 200, 50, 100_000_000


def write(folder: Path) -> None:
    """A run whose ego drives 10 m/s among objects of every direction and speed, half of which are found."""
    random = np.random.default_rng(1)
    place, velocity = random.uniform(-45, 45, (NUM, 2)), random.uniform(-12, 12, (NUM, 2))
    size = np.column_stack([random.uniform(0.6, 9, NUM), random.uniform(0.6, 2.5, NUM), np.full(NUM, 1.6)])
    ids, label = np.arange(NUM), np.where(np.arange(NUM) % 5, "car", "pedestrian")
    with RunWriter(folder) as writer:
        for k in range(NUM_FRAMES):
            stamp_ns, turns = k * STEP_NS, np.where(np.arange(NUM) % 2, 1, -1)
            # Bounded: they drive to and fro, so that all stay in the region.
            along = np.sin(0.1 * k + ids)[:, None] * velocity
            center = np.column_stack([np.clip(place + along, -34, 34), np.zeros(NUM)])
            speeds = np.column_stack([np.cos(0.1 * k + ids)[:, None] * velocity + [10, 0], np.zeros(NUM)])
            truth = Boxes3D(center, size, np.arctan2(*velocity.T[::-1]), velocity_mps=speeds, label=label, track_id=ids)
            shifted = center + np.where(turns > 0, 0.3, 5.0)[:, None] * [1, 1, 0]
            found = Boxes3D(shifted, size, truth.yaw_rad, velocity_mps=speeds, label=label, track_id=ids,
                            score=np.linspace(0.2, 0.9, NUM))  # fmt: skip
            writer.add_frame(FrameRecord(k, stamp_ns, 0, None, {}, "", ""), {"total": 1})
            writer.add_boxes("detections", k, found)
            writer.add_boxes("tracks", k, found)
            writer.label_frame(k, Truth(stamp_ns, stamp_ns, truth, None))
        writer.set_poses(np.array([[k, 0, 0, 0, 0, 0, 1.0] for k in range(NUM_FRAMES)]))
        writer.finish(
            Manifest(
                complete=True, log=LogEntry(name="made", log_id="made", digest="0" * 32, metadata={}), pipeline="made",
                parameters={}, frames=FrameEntry(reference="lidar", timeout_ns=1, tolerance_ns=1, max_gap_ns=1),
                mounts={}, cameras={}, num_frames=NUM_FRAMES, num_segments=1, digest="", versions={},
            )
        )  # fmt: skip


def main() -> None:
    """Print times of a frame."""
    options = ScoreOptions()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "run"
        write(folder)

        def shared() -> SharedRun:
            run = SharedRun(folder)
            _ = run.truth_table("3d"), run.detections, run.tracks, run.poses, run.frames
            return run

        first = shared()
        truth = ground_view(first, first.detections, options).sequence

        def predict() -> None:
            frames = find_ego_motion(first)
            ego = move_ego(frames, truth.steps)
            for objects in (truth.truth, truth.estimates):
                assert objects.size_lwh_m is not None
                bodies = move_objects(objects, truth.steps, frames)
                find_conflicts(ego[objects.step], outline_of({}), bodies, objects.size_lwh_m[:, :2])

        errors = find_critical_errors(first, options)  # compiles
        times = best_by_turns_s(
            {
                "reading": shared,
                "detection": lambda: Detection().scores(shared(), options),
                "tracking": lambda: Tracking().scores(shared(), options),
                "prediction of what is critical": predict,
                "criticality, with matching": lambda: Criticality().scores(shared(), options),
                "events, with matching": lambda: Events().scores(shared(), options),
                "critical errors, after it": lambda: find_critical_errors(first, options),
            },
            5,
            time.process_time,
        )
    print(f"{len(errors)} critical errors in {NUM_FRAMES} frames of {NUM} objects and {NUM} results")
    for name, time_s in times.items():
        own = time_s - (0 if name in _WITHOUT_READING else times["reading"])
        print(f"{name}: {1e3 * own / NUM_FRAMES:.2f} ms a frame")


if __name__ == "__main__":
    main()
