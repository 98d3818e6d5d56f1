import numpy as np
import pytest

from fbench.pipelines.models.samples import INPUT_WH, Batcher, Sample, TrainingSettings, View, crop, whole
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image

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
    view = crop(sample, pixels, (320, 256), float(draw.uniform(0.4, 1.3)), draw)
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
        view = crop(sample, pixels, (320, 256), 2.0, np.random.default_rng(seed))
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
