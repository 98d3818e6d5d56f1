"""Whether a run has tracks: pipelines that only detect say so, or give it away."""

import pytest
from tests.replay.engine.test_run import play
from tests.replay.fakes import Echo, drive

from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Output

NOTHING = Boxes3D.empty()


class Giving(Echo):
    """Gives what it is made with in all frames but the first, in which it finds nothing."""

    def __init__(self, detects, tracks):
        super().__init__()
        self.detects, self.given = detects, tracks

    def step(self, frame):
        found = super().step(frame)
        detections = found.detections if self.detects and frame.index else NOTHING
        return Output(detections, found.tracks if self.given == "some" else self.given, {})


@pytest.mark.parametrize(
    ("detects", "tracks", "has_tracks"),
    [
        (True, "some", True),
        (True, None, False),  # says that it doesn't track
        (True, NOTHING, False),  # never a track beside detections: fills in what it doesn't know
        (False, None, False),
        (False, NOTHING, True),  # tracks, but finds nothing
    ],
)
def test_outputs_tell_whether_a_pipeline_tracks(tmp_path, detects, tracks, has_tracks):
    run = play(drive(), tmp_path / "run", Giving(detects, tracks))
    assert run.manifest.has_tracks is has_tracks
    assert len(run.tracks.boxes) == (20 if tracks == "some" else 0)


@pytest.mark.parametrize("is_tracker", [True, False])
def test_a_pipeline_may_say_it_itself(tmp_path, is_tracker):
    class Sure(Giving):
        def __init__(self):
            super().__init__(True, NOTHING)
            self.is_tracker = is_tracker

    assert play(drive(), tmp_path / "run", Sure()).manifest.has_tracks is is_tracker


def test_no_tracks_and_empty_tracks_are_one_result(tmp_path):
    runs = [play(drive(), tmp_path / name, Giving(True, tracks)) for name, tracks in (("a", None), ("b", NOTHING))]
    assert runs[0].manifest.digest == runs[1].manifest.digest
