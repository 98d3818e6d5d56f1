"""Boxes of both kinds that are one object, and names by benchmark."""

import numpy as np
import pytest

from fbench.metrics.files.logs import stack
from fbench.metrics.reference_runs.rows import names_of
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.formats.sequence import pair_boxes

WORDS = np.array(["Car", "Van", "DontCare"])


def columns(rng, num):
    ids = np.where(rng.random(num) < 0.5, rng.permutation(num), -1)
    label = rng.choice(WORDS, num)
    return {"track_id": ids, "source_label": label, "ignore": label == "DontCare"}


def flats(rng, num) -> Boxes2D:
    return Boxes2D(np.full(num, "cam"), rng.random((num, 4)), **columns(rng, num))


def solids(rng, num) -> Boxes3D:
    return Boxes3D(rng.random((num, 3)), np.ones((num, 3)), np.zeros(num), **columns(rng, num))


@pytest.mark.parametrize("seed", range(20))
def test_twins_are_those_of_each_frame(seed):
    rng = np.random.Generator(np.random.PCG64(seed))
    flat, solid = [flats(rng, n) for n in rng.integers(0, 9, 6)], [solids(rng, n) for n in rng.integers(0, 9, 6)]
    frames = [np.repeat(np.arange(6), sizes) for sizes in ([*map(len, flat)], [*map(len, solid)])]
    together = stack(flat, Boxes2D.empty())[0], stack(solid, Boxes3D.empty())[0]
    found = pair_boxes(*together, *frames)
    starts = np.cumsum([0, *(len(part) for part in solid)])
    expected = [np.where(m < 0, -1, m + s) for m, s in zip(map(pair_boxes, flat, solid), starts, strict=False)]
    np.testing.assert_array_equal(found, np.concatenate(expected))


def test_what_only_some_frames_tell_is_unknown_in_others():
    rng = np.random.Generator(np.random.PCG64(0))
    plain = Boxes2D(np.array(["other"]), np.zeros((1, 4)))
    both, _ = stack([plain, Boxes2D.empty(), flats(rng, 2)], Boxes2D.empty())
    assert both.camera.tolist() == ["other", "cam", "cam"]
    assert (both.track_id[0], both.source_label[0], both.ignore[0]) == (-1, "", False)
    assert both.score is None
    assert len(stack([Boxes3D.empty()], Boxes3D.empty())[0]) == 0


@pytest.mark.parametrize(
    ("family", "source", "label", "ignored", "name"),
    [
        ("kitti-tracking", "Person_sitting", "pedestrian", False, "person_sitting"),
        ("kitti-tracking", "", "bicycle", False, "cyclist"),
        ("kitti-tracking", "vehicle.car", "car", False, "car"),
        ("kitti-tracking", "", "", False, ""),
        ("kitti-tracking", "Car", "car", True, "dontcare"),
        ("mot", "static person", "pedestrian", False, "static person"),
        ("mot", "static person", "pedestrian", True, "static person"),
        ("mot", "Car", "car", True, "distractor"),
        ("nuscenes", "movable_object.barrier", "other", False, "barrier"),
        ("nuscenes-tracking", "movable_object.barrier", "other", False, ""),
        ("nuscenes", "vehicle.emergency.police", "car", False, ""),
        ("nuscenes", "vehicle.car", "car", True, "car"),
        ("nuscenes", "static_object.bicycle_rack", "other", False, "static_object.bicycle_rack"),
        (None, "Tram", "other", False, "tram"),
        (None, "", "car", False, "car"),
    ],
)
def test_names(family, source, label, ignored, name):
    found = names_of(family, np.array([source]), np.array([label]), np.array([ignored]))
    assert found.tolist() == [name]
