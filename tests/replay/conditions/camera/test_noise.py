"""Noise and light of images, against the formulas drawn value by value."""

import numpy as np
import pytest
from tests.replay.conditions.camera.sites import edit, even, image, pixels_of, site, street

from fbench.replay.conditions.camera.light import LowLight, Overexposure
from fbench.replay.conditions.camera.noise import GaussianNoise, ImpulseNoise, ShotNoise, UniformNoise
from fbench.replay.conditions.camera.weather import disturb_image
from fbench.replay.conditions.weather import Weather

SIZE = (400, 300)


def on_gray(condition, value, severity):
    """Values that become of one value."""
    pixels = even(value, SIZE)
    pixels[0, 0] = (0, 128, 255)  # has color, and spans the range
    return edit(condition, image(pixels), severity)[1:].reshape(-1).astype(float)


def drawn(value, draw, num=400_000):
    """What the formula gives, drawn by numpy: values 0 to 255."""
    result = draw(np.full(num, value / 255), np.random.default_rng(3))
    return np.floor(255 * np.clip(result, 0, 1) + 0.5)


def assert_same_distribution(ours, theirs):
    a, b = (np.bincount(x.astype(int), minlength=256).cumsum() / len(x) for x in (ours, theirs))
    assert np.abs(a - b).max() < 0.006


@pytest.mark.parametrize("severity", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("value", [0, 30, 128, 250])
def test_noise_is_distributed_as_its_formula(severity, value):
    s = severity - 1
    sigma, photons = (0.08, 0.12, 0.18, 0.26, 0.38)[s], (60, 25, 12, 5, 3)[s]
    assert_same_distribution(
        on_gray(GaussianNoise(), value, severity), drawn(value, lambda x, r: x + r.normal(0, sigma, x.shape))
    )
    assert_same_distribution(
        on_gray(ShotNoise(), value, severity), drawn(value, lambda x, r: r.poisson(x * photons) / photons)
    )
    assert_same_distribution(
        on_gray(UniformNoise(), value, severity), drawn(value, lambda x, r: x + r.uniform(-sigma, sigma, x.shape))
    )


@pytest.mark.parametrize(("severity", "share"), [(1, 0.03), (2, 0.06), (3, 0.09), (4, 0.17), (5, 0.27)])
def test_impulses_are_black_and_white_alike(severity, share):
    values = on_gray(ImpulseNoise(), 100, severity)
    assert (values == 0).mean() == pytest.approx(share / 2, abs=0.003)
    assert (values == 255).mean() == pytest.approx(share / 2, abs=0.003)
    assert set(np.unique(values)) == {0, 100, 255}


@pytest.mark.parametrize(
    ("severity", "white", "photons", "sigma"),
    [(1, 0.6, 600, 0.008), (2, 0.5, 250, 0.012), (3, 0.4, 120, 0.018), (4, 0.3, 50, 0.026), (5, 0.2, 30, 0.038)],
)
@pytest.mark.parametrize("value", [0, 40, 128, 240])
def test_little_light_is_that_of_its_own_severity(severity, white, photons, sigma, value):
    """Each severity has its own numbers, the first not those of the second; and the fifth is there at all."""

    def draw(x, rng):
        return rng.poisson(white * x * x * photons) / photons + rng.normal(0, sigma, x.shape)

    assert_same_distribution(on_gray(LowLight(), value, severity), drawn(value, draw))


def test_little_light_stretches_what_an_image_has():
    pixels = street() // 4 + 60
    low, high = int(pixels.min()), int(pixels.max())
    stretched = ((pixels.astype(float) - low) / (high - low)) ** 2
    assert edit(LowLight(), image(pixels), 1).mean() == pytest.approx(255 * 0.6 * stretched.mean(), abs=1)


@pytest.mark.parametrize("condition", [LowLight(), GaussianNoise(), ShotNoise(), ImpulseNoise(), UniformNoise()])
def test_one_value_all_over_and_one_pixel(condition):
    for size in ((1, 1), (3, 1)):
        for value in (0, 200, 255):
            for severity in (1, 5):
                assert edit(condition, image(even(value, size)), severity).shape == (size[1], size[0], 3)


@pytest.mark.parametrize("condition", [LowLight(), GaussianNoise(), ShotNoise(), ImpulseNoise(), UniformNoise()])
def test_images_without_color_get_noise_without_color(condition):
    gray = edit(condition, image(street()[..., 0]), 3)
    assert (gray == gray[..., :1]).all()
    colored = edit(condition, image(street()), 3).astype(int)
    assert (np.ptp(colored - street(), axis=2) > 0).any()


@pytest.mark.parametrize("condition", [LowLight(), GaussianNoise(), ShotNoise(), ImpulseNoise(), UniformNoise()])
def test_noise_is_drawn_by_message_and_does_not_repeat(condition):
    pixels = even(120, SIZE)
    pixels[0, 0] = (0, 128, 255)
    first, again, later = (edit(condition, image(pixels, stamp_ns=s), 3).astype(float) for s in (0, 0, 100))
    np.testing.assert_array_equal(first, again)
    a, b = (x[1:].ravel() - x[1:].mean() for x in (first, later))
    assert abs((a * b).mean() / a.std() / b.std()) < 0.01
    assert abs((a[1:] * a[:-1]).mean() / a.var()) < 0.01


def in_light(lux, pixels):
    return pixels_of(disturb_image(image(pixels), Weather(lux=lux), site()))


def test_lux_are_the_levels_of_little_light():
    pixels = street()
    for severity, lux in enumerate((100.0, 30.0, 10.0, 3.0, 0.3), 1):
        expected, found = edit(LowLight(), image(pixels), severity).astype(float), in_light(lux, pixels).astype(float)
        assert found.mean() == pytest.approx(expected.mean(), abs=0.1)
        assert found.std() == pytest.approx(expected.std(), rel=0.01)


def test_less_light_is_darker_without_a_step():
    pixels = street()
    means = [in_light(lux, pixels).mean() for lux in (1000.0, 999.0, 500.0, 200.0, 100.0, 20.0, 5.0, 1.0, 0.3, 0.0)]
    assert means[0] == pixels.mean()
    assert means[1] == pytest.approx(means[0], abs=0.2)
    assert (np.diff(means[1:-1]) < 0).all()
    assert means[-1] == pytest.approx(means[-2], abs=0.1)


@pytest.mark.parametrize("severity", [1, 3, 5])
def test_overexposure_raises_v_and_keeps_hue_and_saturation(severity):
    import colorsys

    pixels = np.random.default_rng(5).integers(0, 256, (20, 20, 3)).astype(np.uint8)
    bright = edit(Overexposure(), image(pixels), severity)
    for before, after in zip(pixels.reshape(-1, 3), bright.reshape(-1, 3), strict=True):
        hue, saturation, v = colorsys.rgb_to_hsv(*(before[::-1] / 255))
        expected = colorsys.hsv_to_rgb(hue, saturation, min(1.0, v + severity / 10))
        np.testing.assert_allclose(after[::-1], 255 * np.array(expected), atol=1.1)


def test_overexposed_black_is_gray():
    assert (edit(Overexposure(), image(even(0, (2, 2))), 5) == 128).all()
