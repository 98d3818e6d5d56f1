"""What some sensor of the log sees, as a slice and as region of interest; all counts by hand."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.metrics.conftest import CAMERA_XYZW, NO_CAMERA, Case, MakeRun, boxes2d, boxes3d, front_camera, write_run
from typer.testing import CliRunner

from fbench.cli.app import make_app
from fbench.metrics.explanation import explain_frame
from fbench.metrics.runs.combine import score_run
from fbench.metrics.runs.detection import Detection
from fbench.metrics.runs.tracking import Tracking
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.rig import Mount, Rig
from fbench.replay.data.scores import Score, ScoreOptions
from fbench.replay.runs.folder import Run

ALL, SEEN = ScoreOptions(), ScoreOptions(seen=1)
EVERY = ("lidar", "radar", "camera")


def rig(*kinds: str) -> Rig:
    """One sensor of each kind at the body's origin; the camera looks forward."""
    front = front_camera() if "camera" in kinds else NO_CAMERA
    others: dict[str, Mount] = {
        kind: Mount(kind, np.zeros(3), CAMERA_XYZW) for kind in ("lidar", "radar") if kind in kinds
    }
    return Rig({**front.mounts, **others}, front.cameras)


def truth(
    *centers: tuple[float, float],
    lidar: Sequence[int] | None = None,
    radar: Sequence[int] | None = None,
    visibility: Sequence[float] | None = None,
    ids: Sequence[int] | None = None,
) -> Boxes3D:
    """Cars with numbers of points."""
    boxes = boxes3d(*centers, label="car", ids=list(range(1, len(centers) + 1)) if ids is None else ids)
    points = (None if num is None else np.array(num, np.int64) for num in (lidar, radar))
    share = None if visibility is None else np.array(visibility, float)
    return replace(boxes, num_lidar_pts=next(points), num_radar_pts=next(points), visibility=share)


def shown(*ids: int, ignore: Sequence[bool] | None = None) -> Boxes2D:
    """Rectangles of these objects in the camera."""
    places = [(50.0 * i, 250.0, 50.0 * i + 40, 290.0) for i in range(len(ids))]
    return boxes2d(*places, label="car", ids=list(ids), ignore=ignore)


def row(run: Run, metric: str, options: ScoreOptions = ALL, part: str = "all", space: str = "bev") -> Score:
    rows = score_run(run, options, (Detection(), Tracking()))
    return next(r for r in rows if (r.metric, r.class_, r.slice) == (metric, "vehicle", part)
                and r.matching.startswith(space))  # fmt: skip


def counts(run: Run, metric: str = "f1", **where: object) -> tuple[float, ...]:
    """(tp, fp, fn, ignored)."""
    c = row(run, metric, **where).counts  # type: ignore[arg-type]
    return c["tp"], c["fp"], c["fn"], c["ignored"]


def must_find(run: Run) -> int:
    """How many truth boxes some sensor sees."""
    c = row(run, "f1", SEEN).counts
    return int(c["tp"] + c["fn"])


# A LiDAR point; a radar echo; an image; nothing; an image that ignores it; not in any image.
CARS = truth((10, 0), (15, 0), (20, 0), (25, 0), (30, 0), (35, 0), lidar=[1, 0, 0, 0, 0, 0], radar=[0, 2, 0, 0, 0, 0])
IN_IMAGE = shown(1, 2, 3, 4, 5, ignore=[True, True, False, True, True])
FOUND = boxes3d((10, 0), (20.5, 0), (25, 0.5), (40, 0), ids=[1, 2, 3, 4])
"""Two that are seen, one that nobody sees, one that isn't there."""


def seen_by_somebody(make_run: MakeRun) -> Run:
    return make_run(Case(FOUND, CARS, IN_IMAGE), rig=rig(*EVERY))


def test_what_nobody_sees_is_neither_missed_nor_a_false_alarm(make_run: MakeRun) -> None:
    run = seen_by_somebody(make_run)
    assert counts(run) == (3, 1, 3, 0)
    assert counts(run, options=SEEN) == (2, 1, 1, 1)
    assert row(run, "f1", SEEN).value == pytest.approx(2 * 2 / (2 * 2 + 1 + 1))


def test_tracks_are_judged_by_the_same_boxes(make_run: MakeRun) -> None:
    run = seen_by_somebody(make_run)
    assert row(run, "mota").value == pytest.approx(1 - (3 + 1) / 6)
    assert row(run, "mota", SEEN).value == pytest.approx(1 - (1 + 1) / 3)
    assert row(run, "mota_no_fp", SEEN).value == pytest.approx(1 - 1 / 3)


@pytest.mark.parametrize("metric", ["f1", "precision", "recall", "mota", "mota_no_fp", "motp", "idsw", "idf1", "hota"])
def test_the_slice_counts_as_the_option_does(make_run: MakeRun, metric: str) -> None:
    run = seen_by_somebody(make_run)
    part, option = row(run, metric, part="seen"), row(run, metric, SEEN)
    assert (part.value, part.counts) == (option.value, option.counts)
    assert part.matching == row(run, metric).matching


def test_the_matching_text_says_so_and_there_is_no_slice_of_the_same(make_run: MakeRun) -> None:
    rows = score_run(seen_by_somebody(make_run), SEEN, (Detection(), Tracking()))
    assert {r.matching for r in rows} == {"bev 2 m, within 50 m, in view, seen", "iou 0.5"}
    assert "seen" not in {r.slice for r in rows}


def test_a_switch_while_nobody_sees_it_still_counts_afterwards(make_run: MakeRun) -> None:
    """Seen as 7, then hidden and followed as 8, then seen as 8: one switch; what was found while hidden is ignored."""
    points = [5, 0, 5]
    cases = [
        Case(boxes3d((10, 0), ids=[track]), truth((10, 0), lidar=[num])) for num, track in zip(points, (7, 8, 8),
                                                                                             strict=True)
    ]  # fmt: skip
    run = make_run(*cases, rig=rig("lidar"))
    assert counts(run, "mota", options=SEEN) == (2, 0, 0, 1)
    assert row(run, "idsw", SEEN).value == 1
    assert row(run, "mota", SEEN).value == pytest.approx(0.5)


class TestEvidence:
    def test_one_point_is_enough(self, make_run: MakeRun) -> None:
        cars = truth((10, 0), (20, 0), (30, 0), lidar=[0, 1, 500])
        assert must_find(make_run(Case(cars, cars), rig=rig("lidar"))) == 2

    def test_as_many_points_as_asked_for_of_one_kind_of_sensor(self, make_run: MakeRun) -> None:
        """Five of the LiDAR or five of the radar, but not three and four; an image shows what it shows."""
        cars = truth((10, 0), (20, 0), (30, 0), (40, 0), lidar=[5, 3, 0, 1], radar=[0, 4, 6, 0])
        run, options = make_run(Case(cars, cars, shown(4)), rig=rig(*EVERY)), ScoreOptions(seen=5)
        assert counts(run, options=options) == (3, 0, 0, 1)
        assert row(run, "f1", options).matching == "bev 2 m, within 50 m, in view, seen with 5 points"
        assert counts(run, part="seen") == (4, 0, 0, 0)
        with pytest.raises(ConfigError, match="-1 points: expected 0 or more"):
            ScoreOptions(seen=-1)

    def test_of_the_sensors_that_the_rig_has(self, make_run: MakeRun) -> None:
        """Without a radar nobody asks for echoes, and without a camera for images or visible shares."""
        cars = truth((10, 0), (20, 0), lidar=[0, 3], visibility=[1.0, 0.0])
        assert must_find(make_run(Case(cars, cars), rig=rig("lidar"))) == 1

    def test_visible_shares_where_no_image_has_truth(self, make_run: MakeRun) -> None:
        """As in nuScenes, whose lowest bin, up to 0.4, also holds what no image shows; unknown shares may be any."""
        cars = truth(
            (10, 0), (20, 0), (30, 0), (40, 0), lidar=[0] * 4, radar=[0] * 4, visibility=[0.2, 0.5, 0.4, np.nan]
        )
        assert must_find(make_run(Case(cars, cars), rig=rig(*EVERY))) == 3

    def test_visible_shares_say_nothing_where_images_have_truth(self, make_run: MakeRun) -> None:
        cars = truth((10, 0), (20, 0), lidar=[0, 0], radar=[0, 0], visibility=[1.0, 1.0])
        assert must_find(make_run(Case(cars, cars, shown(2)), rig=rig(*EVERY))) == 1

    def test_what_isnt_told_of_a_box_may_be(self, make_run: MakeRun) -> None:
        """Negative counts, boxes without an id, and frames whose images have no truth."""
        cars = truth((10, 0), (15, 0), (20, 0), lidar=[0, -1, 0], radar=[0, 0, 0], ids=[1, 2, -1])
        run = make_run(Case(cars, cars, shown(9)), Case(cars, cars), rig=rig(*EVERY))
        assert must_find(run) == 2 + 3

    def test_an_object_is_shown_in_its_own_frame_only(self, make_run: MakeRun) -> None:
        car = truth((10, 0), lidar=[0], radar=[0])
        run = make_run(Case(car, car, shown(1)), Case(car, car, shown(2)), rig=rig(*EVERY))
        assert must_find(run) == 1

    def test_several_cameras_and_ignored_boxes(self, make_run: MakeRun) -> None:
        car = truth((10, 0), lidar=[0], radar=[0])
        both = replace(shown(1, 1, ignore=[True, False]), camera=np.array(["front", "rear"]))
        assert must_find(make_run(Case(car, car, both), rig=front_camera("front", "rear"))) == 1

    @pytest.mark.parametrize(
        ("cars", "kinds"),
        [
            (truth((10, 0)), EVERY),
            (truth((10, 0), lidar=[0]), EVERY),  # who knows what camera and radar see
            (truth((10, 0), lidar=[-1]), ("lidar",)),
            (truth((10, 0), visibility=[np.nan]), ("camera",)),
            (truth((10, 0), lidar=[3]), ()),
        ],
    )
    def test_truth_that_doesnt_tell_is_refused(self, make_run: MakeRun, cars: Boxes3D, kinds: tuple[str, ...]) -> None:
        run = make_run(Case(cars, cars), rig=rig(*kinds))
        with pytest.raises(ConfigError, match=r"doesn't tell of each kind of sensor.*without --seen"):
            row(run, "f1", SEEN)
        assert "seen" not in {r.slice for r in score_run(run, ALL, (Detection(), Tracking()))}

    def test_truth_of_which_one_kind_sees_all_tells_enough(self, make_run: MakeRun) -> None:
        """As in KITTI, where every object is labeled in the image, too."""
        cars = truth((10, 0), (20, 0))
        assert must_find(make_run(Case(cars, cars, shown(1, 2)), rig=rig("lidar", "camera"))) == 2
        with pytest.raises(ConfigError, match="without --seen"):
            must_find(make_run(Case(cars, cars, shown(1)), rig=rig("lidar", "camera")))

    def test_nothing_in_truth_is_no_reason_to_refuse(self, make_run: MakeRun) -> None:
        nothing = Boxes3D.empty()
        run = make_run(Case(boxes3d((10, 0), ids=[1]), nothing), rig=rig(*EVERY))
        assert counts(run, options=SEEN) == (0, 1, 0, 0)


def test_truth_that_is_ignored_anyway_stays_so(make_run: MakeRun) -> None:
    car = replace(truth((10, 0), lidar=[9]), ignore=np.array([True]))
    assert counts(make_run(Case(car, car), rig=rig("lidar")), options=SEEN) == (0, 0, 0, 1)


def test_truth_projected_into_images(make_run: MakeRun) -> None:
    cars = truth((10, 0), (20, 8), lidar=[0, 7], visibility=[0.2, 0.2])
    run = make_run(Case(cars, cars), rig=rig("lidar", "camera"))
    assert counts(run, space="iou") == (2, 0, 0, 0)
    assert counts(run, options=SEEN, space="iou") == (1, 0, 0, 1)
    assert row(run, "f1", SEEN, space="iou").matching == "iou 0.5, truth projected from 3D, within 50 m, in view, seen"


def test_2d_results_on_projected_truth_have_the_slice(make_run: MakeRun) -> None:
    """Front faces at x = 8 and 18 m: 400 / 8 = 50 and 400 / 18 = 22.2 px a meter."""
    cars = truth((10, 0), (20, 8), lidar=[0, 7], visibility=[0.2, 0.2])
    found = replace(boxes2d((349.5, 262, 449.5, 337)), track_id=np.array([1]))
    run = make_run(Case(found, cars), rig=rig("lidar", "camera"))
    assert counts(run, space="iou") == (1, 0, 1, 0)
    for metric in ("f1", "mota"):
        assert counts(run, metric, part="seen", space="iou") == (0, 0, 1, 1)


def test_truth_in_images_is_left_as_it_is(make_run: MakeRun) -> None:
    """It ignores what it doesn't show by itself."""
    run = make_run(Case(shown(1, 2, 3), CARS, IN_IMAGE), rig=rig(*EVERY))
    assert counts(run, space="iou") == counts(run, options=SEEN, space="iou") == (1, 0, 0, 2)


def test_explained(make_run: MakeRun) -> None:
    table = explain_frame(seen_by_somebody(make_run), SEEN, 0).tables[0]
    assert [(v.outcome, v.reason) for v in table.truth[3:]] == [("ignored", "no sensor sees it")] * 3
    assert table.estimates[2].reason == "on truth 3, which needn't be found: no sensor sees it"


def test_on_the_command_line(tmp_path: Path) -> None:
    write_run(tmp_path / "run", [Case(FOUND, CARS, IN_IMAGE)], rig(*EVERY))
    runner = CliRunner()
    told = runner.invoke(make_app("score"), ["score", str(tmp_path / "run"), "--seen", "1", "--explain", "0"])
    assert told.exit_code == 0
    assert "bev 2 m, within 50 m, in view, seen" in told.stdout
    refused = runner.invoke(make_app("score"), ["score", str(tmp_path / "run"), "--seen", "1", "--profile", "coco"])
    assert str(refused.exception) == "--seen doesn't go with --profile"
