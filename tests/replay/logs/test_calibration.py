"""Calibration that can't be used: one line that names the sensor."""

from dataclasses import replace

import numpy as np
import pytest
from tests.replay.logs import builders as b

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.rig import Rig


def with_mount(name, **changes):
    rig = b.the_rig()
    return Rig({**rig.mounts, name: replace(rig.mounts[name], **changes)}, rig.cameras)


def with_camera(**changes):
    rig = b.the_rig()
    return Rig(rig.mounts, {"cam": replace(rig.cameras["cam"], **changes)})


@pytest.mark.parametrize(
    ("rig", "message"),
    [
        (with_mount("top", rotation_xyzw=np.zeros(4)), "sensor 'top': transform of 'top' has no valid rotation"),
        (with_mount("top", rotation_xyzw=np.full(4, np.nan)), "sensor 'top': transform of 'top' has no valid rot"),
        (with_mount("front", translation_m=np.array([0, np.nan, 0])), "transform of 'front' isn't finite; repair"),
        (with_camera(K=np.full((3, 3), np.nan)), "camera 'cam'"),
        (with_camera(K=np.diag([0.0, 1, 1])), "camera 'cam'"),
        (with_camera(distortion=np.array([np.inf])), "camera 'cam'"),
        (with_camera(size_wh=(0, 0)), "camera 'cam'"),
    ],
)
def test_invalid_calibration_is_refused(tmp_path, rig, message):
    reader, _ = b.read(b.write(tmp_path / "log.mcap", b.sequence(2), rig))
    with pytest.raises(LogError, match=message):
        _ = reader.rig
