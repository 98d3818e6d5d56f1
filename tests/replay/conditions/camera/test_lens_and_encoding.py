"""Blur, lens and compression, by what must come out."""

import cv2
import numpy as np
import pytest
from tests.replay.conditions.camera.sites import edit, even, image, site, street

from fbench.replay.conditions.camera.blur import Defocus, MotionBlur, blur_along
from fbench.replay.conditions.camera.encoding import JpegArtifacts, Pixelation, Quantization
from fbench.replay.conditions.camera.lens import LensDirt, SunGlare, dirt
from fbench.replay.conditions.generators import generator
from fbench.replay.conditions.spec import load_condition
from fbench.replay.contracts.entry_points import entry_points_of
from fbench.replay.data.images import encode_jpeg

NAMES = [name for name in entry_points_of("conditions") if name.startswith("camera.")]
EDITED = [name for name in NAMES if name not in ("camera.crash", "camera.frame_lost", "camera.frozen")]


def point():
    pixels = even(0, (101, 101))
    pixels[50, 50] = 255
    return pixels


def test_all_conditions_of_cameras_are_there():
    assert [
        f"camera.{name}"
        for name in [
            "crash",
            "defocus",
            "fog_nodepth",
            "frame_lost",
            "frozen",
            "gauss",
            "glare",
            "impulse",
            "jpeg",
            "lens_dirt",
            "lowlight",
            "motion_blur",
            "overexpose",
            "pixelate",
            "quant",
            "shot",
            "uniform",
        ]
    ] == NAMES


@pytest.mark.parametrize("name", EDITED)
def test_every_severity_changes_more_and_no_input(name):
    changes, condition = [], load_condition(name)
    for severity in range(1, 6):
        total = 0.0
        for n in range(4):
            given = image(street(n), stamp_ns=n)
            changed = edit(condition, given, severity, site(seed=n))
            total += np.abs(changed.astype(int) - street(n)).mean()
            assert given.data == street(n).tobytes()
        changes.append(total)
    assert changes[0] > 0
    assert (np.diff(changes) > 0).all()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("size", [(1, 1), (1, 5), (6, 1), (31, 17)])
def test_tiny_images_keep_their_size(name, size):
    for severity in (1, 5):
        assert edit(load_condition(name), image(even(77, size)), severity).shape == (size[1], size[0], 3)


@pytest.mark.parametrize("name", sorted({*NAMES} - {"camera.glare", "camera.lens_dirt"}))
def test_gray_images_stay_gray(name):
    result = edit(load_condition(name), image(street()[..., 0]), 3)
    assert (result == result[..., :1]).all()


def test_motion_blur_turns_a_point_into_a_line():
    for severity, radius in ((1, 10), (3, 15), (5, 20)):
        blurred = edit(MotionBlur(), image(point()), severity)[..., 0].astype(int)
        v, u = np.nonzero(blurred)
        assert np.hypot(np.ptp(v), np.ptp(u)) <= 2 * radius + 2
        assert blurred.sum() == pytest.approx(255, abs=25)
        _, vectors = np.linalg.eigh(np.cov(np.stack([u, v])))
        angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
        assert min(abs(angle), 180 - abs(angle)) <= 47


def test_motion_blur_is_half_a_gaussian():
    blurred = blur_along(point(), 10, 3.0, 0.0)[50, :, 0].astype(float)
    line = blurred[blurred > 0]
    np.testing.assert_allclose(
        sorted(line / line.max(), reverse=True)[:6], np.exp(-0.5 * (np.arange(6) / 3) ** 2), atol=0.03
    )


@pytest.mark.parametrize(("severity", "radius"), [(1, 3), (2, 4), (3, 6), (4, 8), (5, 10)])
def test_defocus_turns_a_point_into_a_disc(severity, radius):
    blurred = edit(Defocus(), image(25 * (point() > 0) * 10), severity)[..., 0].astype(float)
    across = np.arange(-50, 51)
    disc = across**2 + across[:, None] ** 2 <= radius**2
    assert blurred[disc].sum() / max(blurred.sum(), 1) > 0.8
    assert np.count_nonzero(blurred) >= 0.9 * disc.sum() if severity < 5 else True


def test_blur_keeps_even_images():
    for condition in (MotionBlur(), Defocus()):
        assert (edit(condition, image(even(93)), 5) == 93).all()


def test_glare_is_a_white_disc_that_stays():
    for seed in range(6):
        at = site(seed=seed)
        first, later = (edit(SunGlare(), image(even(40), stamp_ns=s), 5, at) for s in (0, 900))
        np.testing.assert_array_equal(first, later)
        v, u = np.nonzero((first == (235, 248, 255)).all(axis=2))
        assert 0.25 <= u.mean() / 319 <= 0.75
        assert 0.30 <= v.mean() / 239 <= 0.45
        assert len(u) == pytest.approx(np.pi * (70 * 320 / 1600) ** 2, rel=0.1)
        assert first[0, 0, 0] < first[round(v.mean()), max(0, round(u.mean()) - 30), 0]


@pytest.mark.parametrize("share", [0.02, 0.05, 0.1, 0.2, 0.3])
def test_dirt_covers_its_share(share):
    layer = dirt(generator(3, "dirt"), (320, 240), share)
    assert np.count_nonzero(layer) / layer.size == pytest.approx(share, abs=1e-3)
    assert layer[layer > 0].min() > 0
    assert layer.max() <= 0.92


def test_dirt_stays_and_is_another_in_another_log_or_camera():
    first, later = (edit(LensDirt(), image(even(200), stamp_ns=s), 3) for s in (0, 900))
    np.testing.assert_array_equal(first, later)
    other = edit(LensDirt(), image(even(200), "right"), 3)
    assert (first != other).any()


def test_jpeg_is_what_a_decoder_makes_of_it():
    expected = cv2.imdecode(np.frombuffer(encode_jpeg(street(), 10), np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(edit(JpegArtifacts(), image(street()), 4), expected)


def test_pixels_become_squares_of_means():
    blocks = edit(Pixelation(), image(street()), 5)
    squares = blocks.reshape(60, 4, 80, 4, 3)
    assert (squares == squares[:, :1, :, :1]).all()
    means = street().reshape(60, 4, 80, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(squares[:, 0, :, 0], means, atol=0.51)


@pytest.mark.parametrize(("severity", "bits"), [(1, 5), (2, 4), (3, 3), (4, 2), (5, 1)])
def test_some_bits_are_left_of_each_value(severity, bits):
    ramp = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, axis=2)
    found = edit(Quantization(), image(ramp), severity)[0, :, 0].astype(int)
    assert len(np.unique(found)) == 2**bits
    assert (found[0], found[-1]) == (0, 255)
    assert np.abs(found - np.arange(256)).max() <= 255 / (2**bits - 1) / 2 + 1
