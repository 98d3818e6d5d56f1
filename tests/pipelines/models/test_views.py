from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from fbench.pipelines.models.samples import CLASSES, INPUT_WH, RgbdSettings, Sample, TrainingSettings, rarity
from fbench.pipelines.models.views import Batcher, View, add_channels, crop, make_ahead, whole
from fbench.pipelines.sensors.camera.channels import ImagePoints
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image

EVEN = np.ones(len(CLASSES))
GREEN = np.array([0, 255, 0], np.uint8)


def made(*xyxy: tuple[int, int, int, int], size_wh: tuple[int, int] = (800, 600)) -> tuple[Sample, np.ndarray]:
    """A grey image with green rectangles, one object each."""
    pixels = np.full((size_wh[1], size_wh[0], 3), 90, np.uint8)
    for left, top, right, bottom in xyxy:
        pixels[top:bottom, left:right] = GREEN
    image = Image("front", 0, 0, encode_jpeg(pixels, 98), "jpeg", size_wh)
    return Sample("made", image, np.array(xyxy, np.float64).reshape(-1, 4), np.zeros(len(xyxy), np.int64)), pixels


def outline(view: View) -> np.ndarray:
    """Rectangle around what is green."""
    rgb = view.pixels.astype(int)
    green = rgb[..., 1] - (rgb[..., 0] + rgb[..., 2]) / 2 > 60
    v, u = np.nonzero(green)
    return np.array([u.min(), v.min(), u.max() + 1, v.max() + 1])


@pytest.mark.parametrize("seed", range(40))
def test_boxes_move_with_what_they_show(seed):
    draw = np.random.default_rng(seed)
    sample, pixels = made((300, 250, 420, 330))
    view = crop(sample, pixels, (320, 256), float(draw.uniform(0.4, 1.3)), EVEN, draw)
    assert view.pixels.shape == (256, 320, 3)
    if (view.class_id == 0).any():
        np.testing.assert_allclose(outline(view), view.xyxy[0], atol=1.6)


def test_whole_images_fill_the_input():
    sample, pixels = made((0, 0, 800, 600))
    view = whole(sample, pixels, INPUT_WH, np.random.default_rng(0))
    assert view.xyxy.tolist() == [[0, 0, 640, 480]]
    np.testing.assert_allclose(outline(view), [0, 0, 640, 480], atol=1)


def test_wide_images_get_a_grey_border():
    sample, pixels = made((0, 0, 1280, 640), size_wh=(1280, 640))
    view = whole(sample, pixels, INPUT_WH, np.random.default_rng(0))
    assert view.xyxy.tolist() == [[0, 80, 640, 400]]
    np.testing.assert_allclose(outline(view), [0, 80, 640, 400], atol=1)


def test_what_is_mostly_cut_away_is_ignored_and_what_is_outside_is_gone():
    sample, pixels = made((0, 0, 100, 100), (700, 500, 800, 600))
    for seed in range(40):
        view = crop(sample, pixels, (320, 256), 2.0, EVEN, np.random.default_rng(seed))
        sides = (view.xyxy[:, 2:] - view.xyxy[:, :2]).prod(axis=1)
        assert (sides > 0).all()
        assert ((sides >= 0.35 * 200 * 200) == (view.class_id == 0)).all()


def test_a_batch_depends_on_its_step_alone():
    sample, _ = made((300, 250, 420, 330))
    batcher = Batcher([sample] * 3, TrainingSettings(crops=2, wholes=1))
    straight = list(batcher.batches(0, 7))
    later = list(batcher.batches(5, 7))
    assert [len(views) for views in straight] == [1, 2, 2, 2, 2, 1, 2], "every fifth is of whole images"
    for one, other in zip(straight[5:], later, strict=True):
        for a, b in zip(one, other, strict=True):
            assert (a.pixels == b.pixels).all()
            assert (a.xyxy == b.xyxy).all()


def test_another_seed_shows_other_views():
    sample, _ = made((300, 250, 420, 330))
    views = [Batcher([sample], TrainingSettings(seed=seed, crops=1)).batch(1)[0] for seed in (1, 2)]
    assert (views[0].pixels != views[1].pixels).any()


def test_rare_classes_are_drawn_more_often_by_the_root_of_how_rare_they_are():
    common, _ = made((300, 250, 420, 330))
    rare = replace(common, class_id=np.array([3]))
    samples = [common] * 15 + [rare]
    assert rarity(samples, 0.25).tolist() == [1, 2, 2, 2, 2, 2, 2], "one in 16 or none shows it: sqrt(4)"
    batcher = Batcher(samples, TrainingSettings(crops=8, common=0.25))
    shown = [view.class_id.tolist() for step in range(1, 200, 5) for view in batcher.batch(step)]
    share = sum(3 in ids for ids in shown) / sum(bool(ids) for ids in shown)
    assert 1.5 / 17 < share < 2.7 / 17, "twice as often as others: 2 of 17"


def with_points() -> tuple[Sample, np.ndarray]:
    """LiDAR points along the outline of an object, and an echo in its middle."""
    sample, pixels = made((300, 250, 420, 330))
    u, v = np.meshgrid([300.5, 360.0, 419.5], [250.5, 290.0, 329.5])
    lidar = np.column_stack([u.ravel(), v.ravel(), np.full(9, 10.0)]).astype(np.float32)
    echo = np.array([[360.0, 290.0, 10.0, 5.0]], np.float32)
    return replace(sample, points=ImagePoints(lidar, echo, 400.0)), pixels


WHOLE = RgbdSettings(without_points=0, without_lidar=0, without_radar=0, without_image=0, thinned=0)


@pytest.mark.parametrize("seed", range(20))
def test_points_move_with_what_they_show(seed):
    draw = np.random.default_rng(seed)
    sample, pixels = with_points()
    view = crop(sample, pixels, (320, 256), float(draw.uniform(0.5, 1.2)), EVEN, draw)
    if len(view.xyxy) and (view.xyxy[0] > 3).all() and (view.xyxy[0] < (317, 253, 317, 253)).all():
        drawn = add_channels(view, WHOLE, draw).pixels
        assert drawn.shape == (256, 320, 5)
        v, u = np.nonzero(drawn[..., 3])
        np.testing.assert_allclose([u.min(), v.min(), u.max() + 1, v.max() + 1], view.xyxy[0], atol=2.5)
        assert drawn[..., 4].max() == 160, "5 of 20 m/s: 128 + 127 / 4"


def test_what_is_larger_in_the_view_is_drawn_nearer():
    sample, pixels = with_points()
    near, far = (
        add_channels(crop(sample, pixels, (640, 512), scale, EVEN, np.random.default_rng(5)), WHOLE,
                     np.random.default_rng(0)).pixels[..., 3].max()
        for scale in (1.0, 0.5)
    )  # fmt: skip
    step = 254 / np.log(120 / 1.5)
    assert int(near) - int(far) == pytest.approx(step * np.log(2), abs=1)


@pytest.mark.parametrize(("name", "is_gone"), [
    ("without_points", (False, True, True)), ("without_lidar", (False, False, False)),
    ("without_radar", (False, False, True)), ("without_image", (True, False, False)),
])  # fmt: skip
def test_what_is_missing_is_blank(name, is_gone):
    sample, pixels = with_points()
    view = whole(sample, pixels, INPUT_WH, np.random.default_rng(1))
    drawn = add_channels(view, replace(WHOLE, **{name: 1.0}), np.random.default_rng(0)).pixels
    full = add_channels(view, WHOLE, np.random.default_rng(0)).pixels
    assert (drawn[..., :3] == 114).all() == is_gone[0]
    assert [not drawn[..., channel].any() for channel in (3, 4)] == list(is_gone[1:])
    if name == "without_lidar":
        assert 0 < np.count_nonzero(drawn[..., 3]) < np.count_nonzero(full[..., 3]), "the echo's depth is left"


def test_half_of_the_views_are_of_recordings_beside_simulated_logs():
    sample, _ = made((40, 40, 120, 90), size_wh=(160, 120))
    mixed = [replace(sample, class_id=np.array([2]), is_recorded=True), *[sample] * 9]
    batcher = Batcher(mixed, TrainingSettings(wholes=4, whole_every=1))
    drawn = [int(view.class_id[0]) == 2 for step in range(60) for view in batcher.batch(step)]
    assert np.mean(drawn) == pytest.approx(0.5, abs=0.1)


def test_what_is_made_ahead_comes_in_order():
    def parts(step):
        return (partial(lambda a, b: (a, b), step, place) for place in range(3))

    assert list(make_ahead(parts, range(2, 9), 4)) == [[(step, place) for place in range(3)] for step in range(2, 9)]
