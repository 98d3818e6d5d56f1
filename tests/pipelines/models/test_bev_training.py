from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is an extra")
pytest.importorskip("onnx", reason="onnx is an extra")

from fbench.pipelines.models.bev_network import BevNetwork, export  # noqa: E402
from fbench.pipelines.models.bev_samples import BevSample, BevSettings, bev_samples, count_inside  # noqa: E402
from fbench.pipelines.models.bev_train import BevTraining  # noqa: E402
from fbench.pipelines.models.bev_views import BevBatcher, add_clutter, view  # noqa: E402
from fbench.pipelines.sensors.bev.grid import NUM_CHANNELS, SIDE, BevPoints  # noqa: E402
from fbench.pipelines.sensors.camera.model import load  # noqa: E402
from fbench.replay.conditions.generators import generator  # noqa: E402
from fbench.replay.contracts.errors import LogError  # noqa: E402
from fbench.replay.contracts.faults import FaultLog  # noqa: E402
from fbench.replay.data.boxes import Boxes3D  # noqa: E402
from fbench.replay.data.messages import PointCloud, Truth  # noqa: E402
from fbench.replay.data.rig import LogInfo, Mount, Rig  # noqa: E402
from fbench.replay.logs.containers.mcap.write import McapWriter  # noqa: E402

pytestmark = pytest.mark.torch


@pytest.fixture(scope="module")
def made() -> list[BevSample]:
    """A block of points in a box, and echoes."""
    draw, found = np.random.default_rng(0), []
    for index in range(3):
        box = np.array([[10.0 + index, 5.0, 0.8, 4.4, 1.8, 1.6, 0.4, 5.0, 0.0]], np.float32)
        inner = draw.uniform(-0.5, 0.5, (400, 2)) * (4.4, 1.8)
        c, s = np.cos(0.4), np.sin(0.4)
        xy = inner @ np.array([[c, s], [-s, c]]) + box[0, :2]
        lidar = np.column_stack([xy, draw.uniform(0.3, 1.5, 400)]).astype(np.float32)
        radar = np.column_stack([xy[:20], np.full(20, 0.7), np.full(20, 4.0)]).astype(np.float32)
        eye = np.array([0, 0, 2.0], np.float32)
        found.append(BevSample(f"made {index}", BevPoints(lidar, radar), eye, box, np.array([0])))
    return found


def test_views_keep_points_in_their_boxes(made):
    settings = BevSettings(turned=1.0, thinned=0.0, sensors=(1.0, 0.0, 0.0))
    places = set()
    for place in range(12):
        shown = view(made[0], settings, generator(1, "view", 0, place))
        assert count_inside(shown.points.lidar, shown.boxes, 0.15, 0.0)[0] == 400
        assert shown.is_speed_known.tolist() == [1]
        places.add(tuple(shown.boxes[0, :2].tolist()))
    assert len(places) == 12, "each view is another"


def test_what_nothing_is_seen_of_need_not_be_found(made):
    settings = BevSettings(turned=0.0, thinned=0.0, sensors=(0.0, 1.0, 0.0))
    empty = BevSample("empty", BevPoints(made[0].points.lidar[:2], made[0].points.radar), made[0].eye, made[0].boxes,
                      made[0].class_id)  # fmt: skip
    assert view(made[0], settings, generator(1, "view", 0, 0)).class_id.tolist() == [0]
    shown = view(empty, settings, generator(1, "view", 0, 0))
    assert len(shown.points.radar) == 0
    assert shown.class_id.tolist() == [-1], "two points, and no echoes"


def test_clutter_stands_beside_boxes_and_leaves_the_rest_as_it_is(made):
    points, boxes = made[0].points, made[0].boxes
    found = [add_clutter(points, boxes, 40.0, generator(1, "clutter", place)) for place in range(20)]
    for one in found:
        lidar, radar = one.lidar[len(points.lidar) :], one.radar[len(points.radar) :]
        assert np.array_equal(one.lidar[: len(points.lidar)], points.lidar)
        assert np.array_equal(one.radar[: len(points.radar)], points.radar)
        assert one.lidar.dtype == one.radar.dtype == np.float32
        assert count_inside(lidar, boxes, 0.15, -1.0)[0] == count_inside(radar, boxes, 0.15, -1.0)[0] == 0
        assert np.abs(radar[:, 3]).max(initial=0) < 1, "nothing of it moves"
    ranges = np.concatenate([np.hypot(*one.lidar[len(points.lidar) :, :2].T) for one in found])
    assert len(ranges) > 1000
    assert 0.1 < np.mean(ranges < 12) < 0.95, "near and far"
    assert len({len(one.lidar) for one in found}) > 10, "each view has its own"


def test_clutter_adds_nothing_where_a_sensor_is_missing_or_none_is_wanted(made):
    points, boxes = made[0].points, made[0].boxes
    blind = add_clutter(BevPoints(points.lidar[:0], points.radar[:0]), boxes, 40.0, generator(1, "clutter"))
    assert (len(blind.lidar), len(blind.radar)) == (0, 0)
    same = add_clutter(points, boxes, 0.0, generator(1, "clutter"))
    assert np.array_equal(same.lidar, points.lidar)
    empty = add_clutter(points, boxes[:0], 40.0, generator(1, "clutter"))
    assert len(empty.lidar) > len(points.lidar)


def test_half_of_the_views_are_of_recordings_beside_simulated_logs(made):
    mixed = [replace(made[0], is_recorded=True), *made[1:] * 4]
    settings = BevSettings(batch=8, turned=0.0, thinned=0.0, sensors=(1.0, 0.0, 0.0), scale=0.0)
    views = [one for batch in BevBatcher(mixed, settings, 1).batches(0, 50) for one in batch]
    recorded = [one.boxes[0, 0] == made[0].boxes[0, 0] for one in views]
    assert np.mean(recorded) == pytest.approx(0.5, abs=0.08)


def test_frames_of_one_kind_are_equally_likely(made):
    settings = BevSettings(batch=8, turned=0.0, thinned=0.0, sensors=(1.0, 0.0, 0.0), scale=0.0)
    for own in (made, [replace(one, is_recorded=True) for one in made]):
        (batch,) = BevBatcher(own, settings, 1).batches(3, 4)
        drawn = generator(settings.seed, "samples", 3).choice(3, 8)
        assert [float(one.boxes[0, 0]) for one in batch] == [10.0 + index for index in drawn]


@pytest.mark.parametrize("aside_m", [0.0, 40.0])
def test_truth_without_points_teaches_nothing(made, tmp_path, aside_m):
    mount = Mount("lidar", np.array([0, 0, 0.0]), np.array([0, 0, 0, 1.0]))
    box = Boxes3D(
        np.array([[10.0, 5.0 + aside_m, 0.8]]), np.array([[4.4, 1.8, 1.6]]), np.array([0.4]), label=np.array(["car"])
    )
    with McapWriter(tmp_path / "a.mcap", LogInfo("made", log_id="made-1"), Rig({"lidar": mount}, {})) as log:
        log.write(PointCloud("lidar", 100, 100, made[0].points.lidar))
        log.write(Truth(100, 100, boxes3d=box))
    if not aside_m:
        assert len(bev_samples([tmp_path / "a.mcap"], 1, FaultLog())) == 1
        return
    with pytest.raises(LogError, match="no 3D truth in these logs holds points"):
        bev_samples([tmp_path / "a.mcap"], 1, FaultLog())


@pytest.mark.slow
def test_the_file_gives_what_the_network_gives(tmp_path):
    torch.manual_seed(3)
    network = BevNetwork().eval()
    points = np.random.default_rng(2).random((1, NUM_CHANNELS, SIDE, SIDE), np.float32)
    with torch.no_grad():
        wanted = network(torch.from_numpy(points)).numpy()
    export(network, tmp_path / "a.onnx", {"seed": "3"})
    session = load(tmp_path / "a.onnx", 1)
    (found,) = session.run(None, {"points": points})
    assert np.abs(found[:, 1:] - wanted[:, 1:]).max() < 1e-4
    assert np.abs(found[:, 0] - 1 / (1 + np.exp(-wanted[:, 0]))).max() < 1e-5
    assert session.get_modelmeta().custom_metadata_map["seed"] == "3"


@pytest.mark.slow
def test_one_seed_gives_the_same_weights_and_another_others(made, tmp_path):
    found = []
    for turn, seed in enumerate((1, 1, 2)):
        settings = BevSettings(seed=seed, steps=2, batch=1)
        trained = BevTraining(made, settings, threads=1).run(tmp_path / f"{turn}.pt", lambda step, loss: None)
        found.append(torch.cat([value.flatten().double() for value in trained.state_dict().values()]))
    assert torch.equal(found[0], found[1])
    assert not torch.equal(found[0], found[2])
