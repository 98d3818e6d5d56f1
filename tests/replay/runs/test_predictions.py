from pathlib import Path

import numpy as np
import pytest

from fbench.replay.data.boxes import Boxes3D
from fbench.replay.runs.folder import FrameRecord, Run, RunWriter
from fbench.replay.runs.manifest import FrameEntry, LogEntry, Manifest
from fbench.replay.runs.shares import predictions_of


def run_of(folder: Path, parameters: dict[str, object], predicted: list[bool] | None) -> Run:
    """A run of one frame; of none without detections."""
    frames = FrameEntry(reference="lidar", timeout_ns=1, tolerance_ns=1, max_gap_ns=1)
    manifest = Manifest(
        complete=True, log=LogEntry(name="log", log_id="id", digest="d", metadata={}), pipeline="mine",
        parameters=parameters, frames=frames, mounts={}, cameras={}, num_frames=1, num_segments=1, digest="",
        versions={},
    )  # fmt: skip
    with RunWriter(folder) as writer:
        if predicted is not None:
            num = len(predicted)
            boxes = Boxes3D(np.ones((num, 3)), np.ones((num, 3)), np.zeros(num), predicted=np.array(predicted, bool))
            writer.add_frame(FrameRecord(0, 0, 0, None, {}, "", ""), {"total": 1})
            writer.add_boxes("detections", 0, boxes)
        return Run(writer.finish(manifest))


@pytest.mark.parametrize(
    ("parameters", "predicted", "text"),
    [
        ({}, [True, False, True], "2 of 3 detections; scores count them"),
        (
            {"detect_every": 3}, [True, False],
            "1 of 2 detections, as detection ran in one frame of 3; scores count them",
        ),
        ({"detect_every": 2}, [], "0 of 0 detections, as detection ran in one frame of 2; scores count them"),
        ({"detect_every": "often"}, [True], "1 of 1 detections; scores count them"),
    ],
)  # fmt: skip
def test_what_is_predicted(tmp_path: Path, parameters: dict[str, object], predicted: list[bool], text: str):
    assert str(predictions_of(run_of(tmp_path / "run", parameters, predicted))) == text


@pytest.mark.parametrize("predicted", [[False, False], [], None])
def test_nothing_is_said_where_nothing_is(tmp_path: Path, predicted: list[bool] | None):
    assert predictions_of(run_of(tmp_path / "run", {"detect_every": 1}, predicted)) is None
