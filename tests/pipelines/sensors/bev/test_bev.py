"""Drawing, decoding and running of the bird's-eye network."""

from pathlib import Path

import numpy as np
import pytest
from tests.pipelines.frames import cloud, frame, rig, scan
from tests.pipelines.networks import encode_identity

from fbench.datasets.city.rig import thesis_rig
from fbench.pipelines.fusion.early.cloud import DepthStage
from fbench.pipelines.sensors.bev import decoding, grid
from fbench.pipelines.sensors.bev.decoding import NUM_OUTPUTS, DecodingParams, decode
from fbench.pipelines.sensors.bev.detector import BUILTIN, BevParams, LidarNetworkParams, open_detector
from fbench.pipelines.sensors.bev.grid import NO_LIDAR, NO_RADAR, BevPoints, rasterize
from fbench.pipelines.sensors.camera.detector import CITY_WEIGHTS
from fbench.pipelines.sensors.image.params import LidarImageParams
from fbench.pipelines.sensors.lidar.clusters import LidarParams, Obstacles
from fbench.pipelines.sensors.lidar.stage import LidarStage, detect_learned
from fbench.pipelines.sensors.points.ground import Plane
from fbench.pipelines.sensors.radar.stage import Compensated
from fbench.pipelines.variants.late import Late2D, Late2DParams, Late3D, Late3DParams
from fbench.pipelines.variants.learned3d import Learned3D, Learned3DParams
from fbench.pipelines.variants.lidar import Lidar2D, Lidar2DParams, Lidar3D, Lidar3DParams
from fbench.replay.contracts.errors import ConfigError, ModelError
from fbench.replay.contracts.params import StageClock
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.contracts.settings import describe_file
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.rig import LogInfo


def test_points_are_drawn_where_they_are():
    lidar = np.array([[0.1, -0.1, 0.6], [0.2, -0.2, 1.3], [0.2, -0.2, 9.0], [60, 0, 1]], np.float32)
    radar = np.array([[10.0, 5.0, 1.0, -4.0], [10.1, 5.1, 1.0, 2.5], [10.1, 5.1, 4.0, 0.0]], np.float32)
    image = rasterize(BevPoints(lidar, radar))
    row, column = 208, 207  # of 416 cells of 0.25 m: x 0 to 0.25, y -0.25 to 0
    assert np.flatnonzero(image[:9, row, column]).tolist() == [2, 4], "0.5 to 0.8 m and 1.1 to 1.5 m"
    assert image[grid.COUNT, row, column] == pytest.approx(np.log(3) / 4)
    assert image[grid.TOP, row, column] == pytest.approx(1.3 / 3)
    assert image[: grid.COUNT + 1].sum() == pytest.approx(2 + np.log(3) / 4), "nothing is drawn elsewhere"
    row, column = 248, 228
    assert image[grid.ECHOES, row, column] == pytest.approx(np.log(3) / 4)
    assert image[grid.OTHER_ECHOES, row, column] == pytest.approx(np.log(2) / 4)
    assert image[grid.RECEDING, row, column] == pytest.approx(0.25)
    assert image[grid.APPROACHING, row, column] == pytest.approx(0.4)
    assert image[grid.RANGE, 415, 208] == pytest.approx(np.hypot(51.875, 0.125) / 52)


def blank() -> np.ndarray:
    output = np.zeros((NUM_OUTPUTS, 104, 104), np.float32)
    output[decoding.KNOWN] = -1
    return output


def test_a_peak_becomes_the_box_that_its_cell_describes():
    output = blank()
    output[0, 60, 40], output[0, 60, 41] = 0.9, 0.7
    cell = output[:, 60, 40]
    cell[1 + 2] = 3  # a truck
    cell[decoding.OFFSET] = 0.25, -0.5
    cell[decoding.HEIGHT] = 1.5
    cell[decoding.SIZE] = np.log([8, 2.5, 3])
    cell[decoding.AXIS] = np.sin(0.6), np.cos(0.6)
    cell[decoding.FORWARD] = -2  # backward: 0.3 - pi
    cell[decoding.SPEED], cell[decoding.KNOWN] = (-1.2, 0.1), 1
    boxes = decode(output, DecodingParams(0.5, 0.2))
    assert len(boxes) == 1, "its neighbor is no peak"
    assert boxes.center_m[0] == pytest.approx([60.5 + 0.25 - 52, 40.5 - 0.5 - 52, 1.5])
    assert boxes.size_lwh_m[0] == pytest.approx([8, 2.5, 3])
    assert boxes.yaw_rad[0] == pytest.approx(0.3 - np.pi)
    assert boxes.velocity_mps[0] == pytest.approx([-12, 1, 0])
    assert boxes.label.tolist() == ["truck"]
    assert boxes.score[0] == pytest.approx(0.9)


def test_of_equal_neighbors_one_is_a_peak_and_of_overlapping_boxes_the_surest_stays():
    output = blank()
    output[0, 10, 10:13] = 0.6
    output[0, 50, 50], output[0, 50, 53] = 0.6, 0.8
    output[decoding.SIZE, 50] = np.log([2, 9, 2])[:, None]
    output[decoding.AXIS, 10:51] = np.array([0, 1])[:, None, None]
    boxes = decode(output, DecodingParams(0.5, 0.15))
    places = [(round(float(x) + 51.5), round(float(y) + 51.5)) for x, y, _ in boxes.center_m]
    assert places == [(50, 53), (10, 10)]
    assert not len(decode(output, DecodingParams(0.9, 0.15)))
    assert np.isnan(boxes.velocity_mps[:, :2]).all()


def test_a_car_of_points_is_found_and_heights_are_above_the_ground():
    draw = np.random.default_rng(1)
    side = [draw.uniform(8, 12.4, 300), np.full(300, 2.1), draw.uniform(0.3, 1.4, 300)]
    rear = [np.full(150, 8.0), draw.uniform(2.1, 3.9, 150), draw.uniform(0.3, 1.4, 150)]
    points = BevPoints(np.concatenate([np.array(side).T, np.array(rear).T]).astype(np.float32), NO_RADAR)
    detector = open_detector(BevParams(threads=1))
    flat, raised = (detector.detect(points, Plane(0, 0, height), 0.3) for height in (0.0, 5.0))
    assert flat.label[0] in ("car", "van")
    assert np.hypot(*(flat.center_m[0, :2] - (10.2, 3.0))) < 0.7
    assert raised.center_m[0, 2] - flat.center_m[0, 2] == pytest.approx(5)
    none = open_detector(BevParams(threads=1, classes=("bus",))).detect(points, Plane(0, 0, 0), 0.3)
    assert set(none.label) <= {"bus"}
    assert not len(detector.detect(BevPoints(NO_LIDAR, NO_RADAR), Plane(0, 0, 0), 0.3))


def test_the_network_takes_the_place_of_clusters():
    draw, rig = np.random.default_rng(1), thesis_rig().rig()
    side = np.array([draw.uniform(8, 12.4, 300), np.full(300, 2.1), draw.uniform(0.3, 1.4, 300)]).T
    rear = np.array([np.full(150, 8.0), draw.uniform(2.1, 3.9, 150), draw.uniform(0.3, 1.4, 150)]).T
    wall = np.array([draw.uniform(-20, 20, 400), np.full(400, -14.0), draw.uniform(0.3, 2.4, 400)]).T
    road = np.column_stack([draw.uniform(-30, 30, (4000, 2)), np.zeros(4000)])
    params, settings = LidarParams(detector="learned"), SensorSettings(Learned3DParams(), rig)
    stage = LidarStage(rig, LogInfo("log", "id"), params, settings)
    view = stage.detect(stage.obstacles(np.concatenate([side, rear, wall, road]), StageClock()))
    at = int(np.argmin(np.hypot(*(view.boxes.center_m[:, :2] - (10.2, 3.0)).T)))
    inside = view.xyz[view.cluster == at]
    assert len(inside) >= 440, "nearly all of the car's points"
    assert inside[:, 1].min() > 2.0, "and no others"
    assert sorted(set(view.cluster[view.cluster >= 0].tolist())) == list(range(len(view.boxes)))
    assert (np.diff(view.cluster) >= 0).all()
    assert view.learned, "so that fusion believes its classes"
    with pytest.raises(ConfigError, match="detector=learned: early fusion"):
        DepthStage(rig, LogInfo("log", "id"), params, settings, None)


class Four:
    """A network that always finds the first `num` of four cars, 10, 20, 30 and 40 m ahead, and keeps what it gets."""

    def __init__(self, sensors="both", num=4, yaw_rad=0.0):
        self.sensors, self._num, self._yaw_rad = sensors, num, yaw_rad

    def detect(self, points, plane, least):
        self.points = points
        center, size = np.array([[x, 0.0, 0.0] for x in (10.0, 20.0, 30.0, 40.0)]), np.tile([4.0, 2.0, 1.5], (4, 1))
        boxes = Boxes3D(center, size, np.full(4, self._yaw_rad), score=np.linspace(0.9, 0.6, 4))
        return boxes[: self._num]


def echoes(xyz, rate_mps):
    return Compensated(xyz, xyz, rate_mps, np.zeros(len(xyz)), np.ones(len(xyz), np.bool_), rate_mps)


def test_boxes_in_which_only_echoes_lie_stay_and_say_so():
    points = np.array([[9.0, 0, 1.0], [19.5, 0.5, 1.0], [70.0, 0, 1.0]])
    road = np.column_stack([points[:, :2], points[:, 2]]).astype(np.float32)
    found, network = Obstacles(Plane(0, 0, 0.5), points, points[:, 2], points[:0], rows=road), Four()
    radar = echoes(np.array([[10.0, 0.2, 1.0], [31.0, -1.1, 1.5], [50.0, 0, 1.0]]), np.array([5.0, np.nan, -2.0]))
    view = detect_learned(network, found, radar, 0.1)
    assert view.boxes.center_m[:, 0].tolist() == [10, 20, 30], "the fourth holds nothing"
    assert view.boxes.sources.tolist() == [6, 2, 4]
    assert view.cluster.tolist() == [-1, 0, 1, *[2] * 18]
    assert view.xyz[:3].tolist() == [[70, 0, 1], [9, 0, 1], [19.5, 0.5, 1]]
    inner = [np.unique(np.round(column, 6)).tolist() for column in (view.xyz[3:] - [30.0, 0, 0]).T]
    assert inner == [[-1.2, 0, 1.2], [-0.6, 0, 0.6], [-0.45, 0.45]], "whatever heights the echoes have"
    assert view.with_echoes
    assert network.points.radar == pytest.approx(np.array([[10, 0.2, 0.5, 5], [31, -1.1, 1.0, 0], [50, 0, 0.5, -2]]))
    without = detect_learned(network, found, None, 0.1)
    assert without.boxes.sources.tolist() == [2, 2]
    assert not len(network.points.radar)
    assert not without.with_echoes


def test_points_in_a_box_of_echoes_turn_with_it():
    found = Obstacles(Plane(0, 0, 0), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))
    network = Four(yaw_rad=np.pi / 2)
    view = detect_learned(network, found, echoes(np.array([[10.0, 1.5, 0.5]]), np.array([1.0])), 0.1)
    assert np.abs(view.xyz - [10.0, 0, 0]).max(axis=0) == pytest.approx([0.6, 1.2, 0.45])


def test_echoes_where_the_network_sees_nothing_are_nothing():
    found = Obstacles(Plane(0, 0, 0), np.array([[9.0, 0, 1.0]]), np.ones(1), np.zeros((0, 3)))
    view = detect_learned(Four(num=0), found, echoes(np.array([[10.0, 1.5, 0.5]]), np.array([1.0])), 0.1)
    assert not len(view.boxes)
    assert view.cluster.tolist() == [-1]
    assert view.with_echoes
    blind = detect_learned(Four(), Obstacles(None, *[np.zeros((0, 3))] * 3), echoes(np.zeros((1, 3)), np.zeros(1)), 0.1)
    assert not len(blind.boxes)
    assert not blind.with_echoes, "without the ground, it isn't asked"


SIMULATED = {"simulated": "3"}


@pytest.mark.parametrize(
    ("asked", "metadata", "takes"),
    [
        ({}, SIMULATED, True),
        ({}, {}, False),  # the built-in network never saw such radars
        ({"sensors": "both"}, {}, True),
        ({"sensors": "lidar"}, SIMULATED, False),
        ({"weights": Path("mine.onnx")}, {}, True),
    ],
)
def test_the_network_of_late3d_gets_echoes_of_radars_that_it_knows(monkeypatch, asked, metadata, takes):
    params = LidarNetworkParams(**asked)
    network = Four(params.sensors or "both")
    monkeypatch.setattr("fbench.pipelines.sensors.lidar.stage.open_detector", lambda _: network)
    pipeline = Late3D(Late3DParams(lidar=LidarParams(detector="learned", network=params)))
    pipeline.start(rig("lidar", "radar"), LogInfo("log", "id", metadata))
    found = pipeline.step(frame(0, cloud(), scan())).detections
    assert bool(len(network.points.radar)) == takes
    assert len(found)
    pipeline.step(frame(1, cloud()))
    assert not len(network.points.radar)


@pytest.mark.parametrize("classes", [(), ("bus",)])
def test_what_a_network_was_not_asked_for_may_be_in_echoes(classes):
    params = LidarParams(detector="learned", network=LidarNetworkParams(classes=classes, threads=1))
    stage = LidarStage(
        rig("lidar"), LogInfo("log", "id", SIMULATED), params, SensorSettings(Learned3DParams(), rig("lidar"))
    )
    view = stage.view(frame(0, cloud()), StageClock(), echoes(np.array([[10.0, 0, 1.0]]), np.ones(1)))
    assert view.with_echoes == (not classes)


def test_the_network_of_late3d_may_see_nothing_at_all():
    network = LidarNetworkParams(classes=("bus",), threads=1)
    pipeline = Late3D(Late3DParams(lidar=LidarParams(detector="learned", network=network)))
    pipeline.start(rig("lidar", "radar"), LogInfo("log", "id", SIMULATED))
    for messages in ((cloud(), scan()), (scan(),), (cloud(),), ()):
        output = pipeline.step(frame(0, *messages))
        assert output.faults == ()
        pipeline.reset("again")


def test_a_network_of_lidar_needs_points():
    with pytest.raises(ConfigError, match=r"lidar\.network\.sensors: must be both or lidar"):
        LidarParams(detector="learned", network=LidarNetworkParams(sensors="radar"))
    LidarParams(network=LidarNetworkParams(sensors="radar"))  # not used


@pytest.mark.parametrize(("names", "given", "sources"), [("lidar", "lidar", 2), ("lidar radar", "lidar", 2),
                                                        ("lidar radar", "lidar radar", 6)])  # fmt: skip
def test_sources_are_the_sensors_that_delivered(names, given, sources):
    pipeline = Learned3D(Learned3DParams(network=BevParams(min_score=0.01, threads=1)))
    pipeline.start(rig(*names.split()), LogInfo("log", "id"))
    messages = [message for message in (cloud(), scan()) if message.sensor in given.split()]
    found = pipeline.step(frame(0, *messages)).detections
    assert set(found.sources.tolist()) == {sources}


@pytest.mark.parametrize(
    ("metadata", "own", "codes"),
    [({}, False, ["PRD007"]), ({"simulated": "3"}, False, []), ({}, True, [])],
)
def test_the_built_in_network_says_that_it_knows_the_city_alone(tmp_path, metadata, own, codes):
    weights = tmp_path / "mine.onnx"
    weights.write_bytes(BUILTIN.read_bytes())
    named = {"weights": weights} if own else {}
    pipeline = Learned3D(Learned3DParams(network=BevParams(**named)))
    info = LogInfo("drive", "", metadata)
    pipeline.start(rig("lidar", "radar"), info)
    assert [fault.code for fault in pipeline.warnings()] == codes
    lidar = LidarParams(detector="learned", network=LidarNetworkParams(**named))
    stage = LidarStage(rig("lidar"), info, lidar, SensorSettings(Learned3DParams(), rig("lidar")))
    assert [fault.code for fault in stage.warnings()] == codes


def test_what_isnt_such_a_network_is_refused(tmp_path):
    with pytest.raises(ModelError, match=r"city\.onnx: not a bird's-eye network"):
        open_detector(BevParams(weights=CITY_WEIGHTS))
    with pytest.raises(ConfigError, match="weights can't be read"):
        open_detector(BevParams(weights=tmp_path / "none.onnx"))
    (tmp_path / "text.onnx").write_text("text")
    with pytest.raises(ModelError, match=r"text\.onnx: not an ONNX"):
        open_detector(BevParams(weights=tmp_path / "text.onnx"))
    with pytest.raises(ConfigError, match=r"network\.classes: the network knows no 'cars'; did you mean 'car'"):
        open_detector(BevParams(classes=("cars",)))


def test_a_network_is_tried_before_it_is_used(tmp_path):
    data = encode_identity((1, grid.NUM_CHANNELS, grid.SIDE, grid.SIDE), "points")
    (tmp_path / "same.onnx").write_bytes(data)
    with pytest.raises(ModelError, match=r"same\.onnx: not the output of a bird's-eye network"):
        open_detector(BevParams(weights=tmp_path / "same.onnx"))
    (tmp_path / "name.onnx").write_bytes(data.replace(b"points", b"p\xffints"))
    with pytest.raises(ModelError, match=r"name\.onnx: a name in the model isn't UTF-8"):
        open_detector(BevParams(weights=tmp_path / "name.onnx"))


@pytest.mark.parametrize("own", [{"detector": "learned"}, {"network": LidarNetworkParams(sensors="lidar")}])
def test_learned3d_refuses_parameters_of_another_network(own):
    with pytest.raises(ConfigError, match=r"learned3d has a network of its own, set network"):
        Learned3DParams(lidar=LidarParams(**own))


def test_messages_name_the_parameters_of_the_pipeline(tmp_path):
    with pytest.raises(ConfigError, match=r"^lidar\.network\.min_score: expected between 0 and 1, got 2$"):
        LidarNetworkParams(min_score=2)
    with pytest.raises(ConfigError, match=r"^lidar\.network\.classes: the network knows no 'cars'"):
        open_detector(LidarNetworkParams(classes=("cars",)))
    stage = LidarStage(
        rig("lidar"),
        LogInfo("drive", "id"),
        LidarParams(detector="learned"),
        SensorSettings(Lidar3DParams(), rig("lidar")),
    )
    assert [fault.where.split(":")[0] for fault in stage.warnings()] == ["lidar.network"]


@pytest.mark.parametrize(("least", "num"), [(None, 4), (0.75, 2), (0.95, 0)])
def test_the_least_score_counts_beside_other_sensors_too(monkeypatch, least, num):
    class Sure(Four):
        def detect(self, points, plane, least):
            found = super().detect(points, plane, least)
            return found[found.score >= least]

    monkeypatch.setattr("fbench.pipelines.sensors.lidar.stage.open_detector", lambda _: Sure())
    params = LidarNetworkParams() if least is None else LidarNetworkParams(min_score=least)
    stage = LidarStage(
        rig("lidar"), LogInfo("drive", "id"), LidarParams(detector="learned", network=params),
        SensorSettings(Lidar3DParams(), rig("lidar")),
    )  # fmt: skip
    points = np.array([[x, 0.0, 0.5] for x in (10.0, 20.0, 30.0, 40.0)])
    found = Obstacles(Plane(0, 0, 0), points, points[:, 2], points[:0], rows=points.astype(np.float32))
    assert len(stage.detect(found).boxes) == num


@pytest.mark.parametrize("make", [
    lambda lidar: Lidar3D(Lidar3DParams(lidar=lidar)), lambda lidar: Late3D(Late3DParams(lidar=lidar)),
    lambda lidar: Lidar2D(Lidar2DParams(lidar=lidar, lidar_image=LidarImageParams(grouping="space"))),
    lambda lidar: Late2D(Late2DParams(lidar=lidar, lidar_image=LidarImageParams(grouping="space"))),
])  # fmt: skip
def test_runs_say_which_network_was_built_in(tmp_path, make):
    weights = tmp_path / "mine.onnx"
    weights.write_bytes(BUILTIN.read_bytes())
    builtin = {"lidar.network.weights": describe_file(BUILTIN)}
    for lidar, expected in [
        (LidarParams(detector="learned"), builtin), (LidarParams(), {}),
        (LidarParams(detector="learned", network=LidarNetworkParams(weights=weights)), {}),
    ]:  # fmt: skip
        pipeline = make(lidar)
        pipeline.start(rig("lidar", "radar", "cam"), LogInfo("drive", "id"))
        assert dict(pipeline.identity()) == expected


def test_the_network_is_small():
    assert Path(BUILTIN).stat().st_size < 4e6
