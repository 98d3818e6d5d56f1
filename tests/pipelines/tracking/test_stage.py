import pytest

from fbench.pipelines.tracking.stage import DetectionInterval, predict_output
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.params import StageClock
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Fault


@pytest.mark.parametrize(
    ("every", "due"), [(1, [True] * 5), (2, [True, False] * 2 + [True]), (3, [True, False, False, True, False])]
)
def test_the_first_frame_of_a_segment_is_due_and_every_so_many_th_after_it(every: int, due: list[bool]):
    interval = DetectionInterval(every)
    assert [interval.is_due() for _ in range(5)] == due
    interval.reset()
    assert interval.is_due()


@pytest.mark.parametrize("every", [0, -3])
def test_less_than_every_frame_is_refused(every: int):
    with pytest.raises(ConfigError, match=f"detect_every: expected at least 1, got {every}"):
        DetectionInterval(every)


def test_predicted_tracks_stand_for_detections():
    clock, fault = StageClock(), Fault("PRD003", "here")
    with clock.stage("read"):
        pass
    boxes = Boxes3D.empty()
    output = predict_output(lambda: boxes, {"cam": "no weights"}, clock=clock, faults=(fault,))
    assert output.detections is boxes
    assert output.tracks is boxes
    assert (list(output.stage_ns), output.missing, output.faults) == (
        ["read", "track"],
        {"cam": "no weights"},
        (fault,),
    )
    assert list(predict_output(lambda: boxes).stage_ns) == ["track"]
