"""A radar that measures no velocities isn't asked what they mean."""

import numpy as np
import pytest
from tests.replay.logs.builders import write

from fbench.replay.data.messages import RadarScan
from fbench.replay.data.rig import Mount, Rig

START, MS = 1_700_000_000_000_000_000, 1_000_000
RIG = Rig({"radar": Mount("radar", np.zeros(3), np.array([0.0, 0, 0, 1]))}, {})


@pytest.mark.parametrize(
    ("velocity", "is_asked"), [(None, False), (np.full(9, np.nan, "f4"), False), (np.ones(9, "f4"), True)]
)
def test_only_velocities_need_a_sign(guess, tmp_path, velocity, is_asked):
    xyz = np.arange(27, dtype=np.float32).reshape(9, 3)
    scans = [RadarScan("radar", START + i * 100 * MS, START + i * 100 * MS, xyz + i, velocity) for i in range(20)]
    write(tmp_path / "log.mcap", scans, RIG)
    _, text = guess(tmp_path / "log.mcap")
    assert ("doppler" in text) == is_asked
    assert ("ego_motion" in text) == is_asked
