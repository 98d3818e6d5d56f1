"""KITTI's label files beside an imported log are the log's own truth again."""

import numpy as np
import pytest

from fbench.datasets.importing.run import import_one
from fbench.datasets.kitti import Kitti
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.importing import ImportRequest
from fbench.replay.logs.open import open_log
from fbench.replay.logs.setup import BoxSource, Setup


@pytest.mark.parametrize(
    ("folder", "name", "labels", "form"),
    [
        ("kitti_object", "kitti_object", "label_2", "kitti"),
        ("kitti_tracking", "0003", "label_02/0003.txt", "kitti-tracking"),
    ],
)
def test_boxes_of_the_file_are_those_of_the_log(shared, tmp_path, folder, name, labels, form):
    source = shared / "data" / folder
    import_one(Kitti(), source, tmp_path / "log.mcap", ImportRequest((name,)))
    own = [truth for truth in open_log(tmp_path / "log.mcap", FaultLog()).truths() if len(truth.boxes3d)]
    setup = Setup(truth=BoxSource(source / labels, form, camera="image_02"))
    filed = open_log(tmp_path / "log.mcap", FaultLog(), (), setup).truths()
    found = [truth for truth in filed if len(truth.boxes3d)]
    assert [truth.frame_number for truth in found] == [truth.frame_number for truth in own]
    for a, b in zip(found, own, strict=True):
        np.testing.assert_allclose(a.boxes3d.center_m, b.boxes3d.center_m, atol=1e-9)
        np.testing.assert_allclose(np.exp(1j * a.boxes3d.yaw_rad), np.exp(1j * b.boxes3d.yaw_rad), atol=1e-9)
        assert a.boxes2d.xyxy_px.tolist() == b.boxes2d.xyxy_px.tolist()
