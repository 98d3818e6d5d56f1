"""nuScenes detection metrics on 100,000 results: ours against nuscenes-devkit's, on the same boxes in one process.

    python -m venv /tmp/devkit && /tmp/devkit/bin/pip install nuscenes-devkit==1.2.0
    python benchmarks/bench_nuscenes_metrics.py /tmp/devkit/lib/python3.11/site-packages

The devkit pins numpy below 2, but its detection evaluation runs with fbench's: the folder goes to the end of the
search path, so that only what fbench's own environment lacks is taken from it.
"""

import math
import resource
import sys
import time

import numpy as np
from common import best_s

from fbench.metrics.profiles.choose import evaluate
from fbench.metrics.profiles.nuscenes.detection import NuscenesDetection
from fbench.metrics.profiles.nuscenes.settings import DETECTION_RULES
from fbench.replay.data.sequences import Objects, Sequence, Steps

NUM_SCENES, NUM_STEPS, NUM_TRUTH, NUM_RESULTS = 25, 40, 40, 100  # The last two are per sample: 100,000 results in all


def scene(seed: int, num_steps: int = NUM_STEPS) -> Sequence:
    """Truth around the ego; half of the results are near a truth box, the others anywhere."""
    rng = np.random.Generator(np.random.Philox(seed))
    place = rng.uniform(-20, 20, (num_steps, NUM_TRUTH, 2))  # no farther than any class's range
    label = rng.choice(np.array(DETECTION_RULES.classes), (num_steps, NUM_TRUTH))
    found, others = rng.integers(0, NUM_TRUTH, NUM_RESULTS // 2), NUM_RESULTS - NUM_RESULTS // 2
    near = place[:, found] + rng.normal(0, 0.8, (num_steps, len(found), 2))
    centers = np.concatenate([near, rng.uniform(-20, 20, (num_steps, others, 2))], axis=1)
    other = rng.choice(np.array(DETECTION_RULES.classes), (num_steps, others))
    labels = np.concatenate([label[:, found], other], axis=1)
    truth, results = boxes(rng, label, place), boxes(rng, labels, centers)
    return Sequence(f"scene-{seed:04d}", Steps.of_one_stream(num_steps), truth, results)


def boxes(rng: np.random.Generator, label: np.ndarray, xy: np.ndarray) -> Objects:
    n = label.size
    return Objects(
        step=np.repeat(np.arange(len(label)), label.shape[1]),
        label=label.reshape(n),
        track_id=np.full(n, -1),
        score=rng.uniform(0, 1, n),
        center_m=np.column_stack([xy.reshape(n, 2), np.zeros(n)]),
        size_lwh_m=rng.uniform(0.5, 5, (n, 3)),
        yaw_rad=rng.uniform(-np.pi, np.pi, n),
        velocity_mps=rng.normal(0, 2, (n, 3)),
        attribute=np.full(n, "vehicle.moving"),
    )


def ours(sequences: list[Sequence]) -> dict[str, float]:
    profile = NuscenesDetection()
    rows = profile.scores(evaluate(profile, sequences).total, "all")
    return {row.metric: float(row.value) for row in rows if row.class_ == "all" and row.value is not None}


def devkits(sequences: list[Sequence]) -> tuple[float, dict[str, float]]:
    """Seconds of the devkit's evaluation, boxes being made before, and its numbers."""
    from nuscenes.eval.common.config import config_factory  # type: ignore[import-not-found]
    from nuscenes.eval.detection.evaluate import DetectionEval  # type: ignore[import-not-found]

    evaluation = DetectionEval.__new__(DetectionEval)
    evaluation.cfg, evaluation.verbose = config_factory("detection_cvpr_2019"), False
    evaluation.gt_boxes = devkit_boxes(sequences, "truth")
    evaluation.pred_boxes = devkit_boxes(sequences, "estimates")
    start = time.perf_counter()
    metrics = evaluation.evaluate()[0]
    return time.perf_counter() - start, {"nds": metrics.nd_score, "map": metrics.mean_ap}


def devkit_boxes(sequences: list[Sequence], side: str) -> object:
    from nuscenes.eval.common.data_classes import EvalBoxes  # type: ignore[import-not-found]
    from nuscenes.eval.detection.data_classes import DetectionBox  # type: ignore[import-not-found]

    result = EvalBoxes()
    for sequence in sequences:
        own: Objects = sequence.truth if side == "truth" else sequence.estimates
        starts, half_rad = own.starts(len(sequence.steps)), np.asarray(own.yaw_rad) / 2
        center_m, size_m, velocity = (np.asarray(a).tolist() for a in (own.center_m, own.size_lwh_m, own.velocity_mps))
        for step in range(len(sequence.steps)):
            token, made = f"{sequence.name}-{step}", []
            for i in range(starts[step], starts[step + 1]):
                length, width, height = size_m[i]
                made.append(
                    DetectionBox(
                        token,
                        translation=center_m[i],
                        size=[width, length, height],
                        velocity=velocity[i][:2],
                        rotation=[math.cos(half_rad[i]), 0.0, 0.0, math.sin(half_rad[i])],
                        detection_name=str(own.label[i]),
                        detection_score=float(own.score[i]),
                        attribute_name=str(np.asarray(own.attribute)[i]),
                    )
                )
            result.add_boxes(token, made)
    return result


def main() -> None:
    ours([scene(999, 2)])  # compiles
    sequences = [scene(seed) for seed in range(NUM_SCENES)]
    own_s = best_s(lambda: ours(sequences))
    print(f"nuscenes-detection, {NUM_SCENES * NUM_STEPS * NUM_RESULTS} results: {1e3 * own_s:.0f} ms")
    twice = [*sequences, *(scene(seed) for seed in range(NUM_SCENES, 2 * NUM_SCENES))]
    twice_s = best_s(lambda: ours(twice))
    print(f"twice as many: {twice_s / own_s:.2f} times as long")
    long = [scene(0, NUM_STEPS * NUM_SCENES)]
    long_s = best_s(lambda: ours(long))
    print(f"as one sequence: {long_s / own_s:.2f} times as long")
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")
    if len(sys.argv) < 2:
        print("nuscenes-devkit isn't compared: give the site-packages of an environment that has it, see the docstring")
        return
    sys.path.append(sys.argv[1])
    devkit_s, numbers = devkits(sequences)
    mine = ours(sequences)
    assert all(abs(mine[name] - value) < 1e-9 for name, value in numbers.items()), (mine, numbers)
    print(f"nuscenes-devkit {1e3 * devkit_s:.0f} ms, same NDS and mAP: {devkit_s / own_s:.0f} times as fast")


if __name__ == "__main__":
    main()
