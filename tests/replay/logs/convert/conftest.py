"""A log with everything that fbench writes."""

import pytest
from tests.replay.logs import builders as b


@pytest.fixture(scope="session")
def drive(tmp_path_factory):
    """A camera, a LiDAR, a radar, poses and truth, calibrated; 2 s."""
    path = tmp_path_factory.mktemp("drive") / "drive.mcap"
    return b.write(path, sorted(b.sequence(), key=lambda item: item.log_ns), b.the_rig(), chunk_size=5000)
