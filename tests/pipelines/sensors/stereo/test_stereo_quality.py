"""Depth that is noise is told from the images."""

import numpy as np
import pytest
from tests.pipelines.sensors.stereo.pairs import BASELINE_M, HEIGHT_M, SIZE, K, car, frame, image, rig, road, wall

from fbench.pipelines.sensors.stereo.depth import DisparityParams, QualityParams, choose_pair, last_row, rectifier
from fbench.pipelines.sensors.stereo.stage import StereoParams, StereoStage, StereoView
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.params import StageClock
from fbench.replay.data.frames import Frame

SENSORS = rig()
PARAMS = StereoParams(disparity=DisparityParams(shrink=1))


def view(given: Frame, params=PARAMS) -> StereoView:
    return StereoStage(SENSORS, "drive", params).view(given, StageClock(), [])


def test_sharp_images_are_believed_and_noise_is_not():
    scene = [road(), wall(15.0), *car(9.0, 0.0)]
    clear, rough = view(frame(SENSORS, scene)), view(frame(SENSORS, scene, noise=25.0))
    assert clear.sure_share > 0.8
    assert not clear.is_off
    assert len(clear.xyz)
    assert rough.sure_share < 0.3
    assert rough.is_off
    assert not len(rough.xyz)


def test_share_falls_as_noise_grows():
    shares = [view(frame(SENSORS, [road(), wall(15.0)], noise)).sure_share for noise in (0.0, 4.0, 8.0, 16.0, 32.0)]
    assert shares == sorted(shares, reverse=True)


def test_lost_contrast_is_noise():
    """Fog: the same scene, with a twentieth of its contrast."""
    whole = frame(SENSORS, [road(), wall(15.0)])
    messages = {}
    for name, message in whole.messages.items():
        grey = np.frombuffer(message.data, np.uint8).reshape(SIZE[::-1])
        messages[name] = image(name, (190 + (grey / 20.0)).astype(np.uint8))
    assert view(Frame(0, 0, 0, messages)).is_off


@pytest.mark.parametrize("level", [0, 255])
def test_flat_images_are_noise(level):
    flat = np.full(SIZE[::-1], level, np.uint8)
    found = view(Frame(0, 0, 0, {name: image(name, flat) for name in ("left", "right")}))
    assert (found.sure_share, found.is_off) == (0.0, True)


def test_images_of_different_places_are_noise():
    messages = {name: frame(SENSORS, [road(), wall(x)]).messages[name] for name, x in (("left", 30.0), ("right", 7.0))}
    upside_down = np.frombuffer(messages["right"].data, np.uint8)[::-1].reshape(SIZE[::-1])
    assert view(Frame(0, 0, 0, {"left": messages["left"], "right": image("right", upside_down)})).is_off


def test_what_was_seen_before_changes_nothing():
    stage = StereoStage(SENSORS, "drive", PARAMS)
    clear, rough = (frame(SENSORS, [road(), wall(15.0)], noise) for noise in (0.0, 40.0))
    found = [stage.view(one, StageClock(), []).sure_share for one in (clear, rough, clear, rough)]
    assert found[:2] == found[2:]


def test_ground_too_near_to_be_matched_is_left_out():
    how = rectifier(SENSORS, choose_pair(SENSORS, "drive", None, None), 1)
    v = np.arange(300.0)[:, None] - K[1, 2]
    ground = np.where(v > 0, v * BASELINE_M / HEIGHT_M, np.nan) * np.ones((1, 400))
    row = last_row(ground.astype(np.float32), how, 32)
    assert row == pytest.approx(K[1, 2] + 0.95 * 32 * HEIGHT_M / BASELINE_M, abs=1)
    assert last_row(ground.astype(np.float32), how, 1000) == 300
    assert last_row(np.full((300, 400), np.nan, np.float32), how, 32) == 300


def test_the_measure_can_be_set():
    clear = frame(SENSORS, [road(), wall(15.0)])
    strict = StereoParams(disparity=PARAMS.disparity, quality=QualityParams(min_share=1.0))
    assert view(clear, strict).is_off
    rough = frame(SENSORS, [road(), wall(15.0)], noise=25.0)
    lax = StereoParams(disparity=PARAMS.disparity, quality=QualityParams(min_share=0.0))
    assert not view(rough, lax).is_off
    with pytest.raises(ConfigError, match=r"stereo\.quality\.min_share: expected between 0 and 1, got 2"):
        QualityParams(min_share=2.0)
