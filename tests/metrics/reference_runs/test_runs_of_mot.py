"""A run with tracks in images scores as the files of MOTChallenge that it is exported to."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.replay.formats.exports import exported, run_of, stamp, sweeps, write_log

from fbench.metrics.profiles.catalog import profile_of
from fbench.metrics.profiles.choose import run_sequence
from fbench.replay.data.arrays import text_array
from fbench.replay.data.boxes import Boxes2D
from fbench.replay.data.messages import Truth
from fbench.replay.runs.folder import Run

NUM, NUM_TRACKS = 30, 12
WORDS = ("pedestrian", "pedestrian", "pedestrian", "static person", "distractor", "car")
SIZE_PX = np.array([40.5, 90.25])
LABELS = {"static person": "pedestrian", "distractor": "other"}


def drive(seed: int = 5) -> tuple[list[Boxes2D], list[Boxes2D]]:
    """Truth and results of each frame; positions are quarters of pixels, which files hold as they are."""
    rng = np.random.Generator(np.random.PCG64(seed))
    words = rng.choice(WORDS, NUM_TRACKS)
    start = rng.integers(0, 600, (NUM_TRACKS, 2))
    truths, results = [], []
    for frame in range(NUM):
        there = np.flatnonzero(rng.random(NUM_TRACKS) < 0.9)
        corner = start[there] + frame * 2.0
        truths.append(boxes(corner, words[there], there, {"ignore": words[there] == "distractor"}))
        own = rng.random(len(there)) < 0.9
        corner = corner[own] + rng.integers(-40, 41, (int(own.sum()), 2)) / 4
        ids = there[own] + 20 * (rng.random(int(own.sum())) < 0.04)
        score = np.round(rng.random(len(ids)), 2)
        results.append(boxes(corner, np.full(len(ids), "pedestrian"), ids, {"score": score}))
    return truths, results


def boxes(corner, words, ids, more: dict[str, Any]) -> Boxes2D:
    labels = text_array([LABELS.get(word, word) for word in words.tolist()])
    return Boxes2D(
        np.full(len(words), "cam"), np.hstack([corner, corner + SIZE_PX]), label=labels,
        source_label=text_array(words.tolist()), track_id=ids.astype(np.int64), **more,
    )  # fmt: skip


def made_run(tmp_path: Path, truths, results) -> Run:
    items = [*sweeps(NUM), *(Truth(stamp(i), stamp(i), None, truth) for i, truth in enumerate(truths))]
    return Run(run_of(write_log(tmp_path / "walk.mcap", items), lambda i: results[i]))


@pytest.mark.parametrize("profile", ["trackeval-mot", "trackeval-mot20", "motmetrics"])
def test_as_the_files(profile, tmp_path, scored):
    run = made_run(tmp_path, *drive())
    exported("mot", tmp_path / "truth", run.folder, boxes="truth")
    exported("mot", tmp_path / "results", run.folder)
    own = scored(run.folder, "--profile", profile)
    files = scored("--truth", tmp_path / "truth", "--detections", tmp_path / "results", "--profile", profile)
    assert list(own) == list(files)
    for key, (value, counts) in files.items():
        assert own[key][0] == (None if value is None else pytest.approx(value, abs=1e-9)), key
        assert own[key][1] == pytest.approx(counts, abs=1e-9), key
    assert 0.1 < next(value for (metric, *_), (value, _) in own.items() if metric == "mota") < 0.99


def test_results_of_other_classes_are_left_out(tmp_path):
    truths, results = drive()
    results[0] = boxes(np.zeros((2, 2)), np.array(["car", "pedestrian"]), np.array([1, 2]), {"score": np.ones(2)})
    sequence = run_sequence(made_run(tmp_path, truths, results), profile_of("trackeval-mot"))
    assert sequence.estimates.label[sequence.estimates.step == 0].tolist() == ["pedestrian"]
    assert (run_sequence(made_run(tmp_path, truths, results), profile_of("motmetrics")).estimates.step == 0).sum() == 2
