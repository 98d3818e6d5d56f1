"""An offset or a drift is told, and drawn."""

import numpy as np
import pytest

from fbench.replay.data.rig import LogInfo, Rig
from fbench.reports.preview.collect import Spread
from fbench.reports.preview.sample import Instant, Material
from fbench.reports.preview.times import sensor_times, span_axes, ticks, time_panel

MS = 1_000_000


def material(num=12, shift_ms=0.0, delay_ms=5.0, drift_ms=0.0, missing=None):
    """A LiDAR that is the reference, and a camera."""
    stamps = [1000 * MS + 100 * MS * i for i in range(num)]
    camera = [s + round(shift_ms * MS) for s in stamps]
    instants = [Instant(i, s, {"lidar": s, "cam": c}) for i, (s, c) in enumerate(zip(stamps, camera, strict=True))]
    late = [round((delay_ms + drift_ms * i / max(1, num - 1)) * MS) for i in range(num)]
    arrivals = {
        "lidar": [(s, s + 5 * MS) for s in stamps],
        "cam": [(c, c + d) for c, d in zip(camera, late, strict=True)],
    }
    kinds = {"lidar": "lidar", "cam": "camera", "silent": "radar"}
    return Material(
        LogInfo("log", "id"), kinds, Rig({}, {}), {}, "lidar", [], [], num, 0, instants, arrivals,
        {"lidar": num, "cam": num}, missing or {},
    )  # fmt: skip


def remarks(found):
    return {t.sensor: " ".join(t.remarks) for t in sensor_times(found)}


def test_times_that_fit_need_no_remark():
    assert remarks(material()) == {"cam": "", "lidar": "", "silent": ""}
    times = {t.sensor: t for t in sensor_times(material(shift_ms=3.0))}
    assert times["cam"].shift_ms == (3.0, 3.0, 3.0)
    assert times["cam"].delay_ms == (5.0, 5.0, 5.0)
    assert times["silent"].shift_ms is None


def test_an_offset_of_200_ms_is_told():
    assert "always about +200.0 ms from the frame's instant" in remarks(material(shift_ms=200, delay_ms=5))["cam"]
    assert "recorded 195.0 ms before its own stamp" in remarks(material(shift_ms=200, delay_ms=-195))["cam"]
    assert "recorded 305.0 ms after its stamp" in remarks(material(delay_ms=305))["cam"]


def test_a_drift_is_told():
    assert "its clock drifts by" in remarks(material(num=60, drift_ms=80))["cam"]


def test_missing_sensors_have_their_reasons():
    (cam, *_) = sensor_times(material(missing={"cam": {"not there within 30 ms": 4}}))
    assert (cam.num_missing, cam.reasons) == (4, "not there within 30 ms (4)")


def test_an_offset_moves_the_line():
    still, moved = time_panel(material()), time_panel(material(shift_ms=200))
    assert still.shape == moved.shape
    assert np.any(still != moved)
    assert time_panel(material(num=0)).shape == still.shape


def test_ticks_are_round():
    assert ticks(-1.0, 1.0, 4) == [-1.0, -0.5, 0.0, 0.5, 1.0]
    assert ticks(0.0, 730.0, 5) == [0.0, 200.0, 400.0, 600.0]
    assert span_axes(np.array([np.nan]), 2) == (-1.0, 1.0)


@pytest.mark.parametrize("length", [0, 1, 5, 6, 7, 13, 100, 1001])
def test_what_is_kept_is_spread_evenly(length):
    spread = Spread(6)
    for i in range(length):
        spread.offer(i)
    assert len(spread.items) <= 12
    assert len(spread.subset) == min(6, length)
    assert list(spread.subset) == sorted(set(spread.subset))
    if length > 12:
        assert np.diff(spread.subset).max() <= 2 * np.diff(spread.subset).min() + 1
        assert spread.subset[0] == 0
