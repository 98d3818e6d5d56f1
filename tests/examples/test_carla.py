"""The recorder of CARLA drives: units by hand, a drive in a stand-in's world, and the stand-in against the package."""

import importlib
import inspect
import re
import sys
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from tests.examples import carla_stand_in as stand_in
from tests.examples.carla_stand_in import BoundingBox, Location, Rotation, Server, Vector3D
from tests.examples.conftest import ROOT
from tests.program import fbench

from fbench.datasets.city.rig import thesis_rig
from fbench.datasets.city.spec import condition
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.messages import Image, PointCloud, Pose, RadarScan
from fbench.replay.logs.open import open_log
from fbench.replay.runs.folder import Run

RIG = """
[cameras.camera]
translation_m = [2.0, 0.0, 1.0]
size_wh = [160, 120]
[lidars.lidar]
translation_m = [0.0, 0.0, 2.0]
channels = 32
points_per_s = 400000
[radars.radar]
translation_m = [2.0, 0.0, 1.0]
yaw_pitch_roll_deg = [0.0, -5.0, 0.0]
"""
ARGUMENTS = ("Town03", "--seconds", "1", "--warm-up-s", "0.1", "--vehicles", "4", "--pedestrians", "2")


@pytest.fixture(scope="module")
def modules():
    """The example's modules, forgotten afterwards; depth cameras are small."""
    names = ("conversions", "truth", "simulation", "record")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "examples" / "carla"))
        found = SimpleNamespace(**{name: importlib.import_module(name) for name in names})
        patch.setattr(found.truth, "FACE_PX", 60)
        yield found
    for name in names:
        sys.modules.pop(name, None)


def record(modules, server, folder, *arguments, name="drive.mcap"):
    (folder / "rig.toml").write_text(RIG)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "carla", stand_in.package(server))
        words = (*ARGUMENTS, "--rig", folder / "rig.toml", "-o", folder / name, *arguments)
        return modules.record.main([str(word) for word in words])


@pytest.fixture(scope="module")
def drive(modules, tmp_path_factory):
    """A second of driving by night, and the server afterwards."""
    folder, server = tmp_path_factory.mktemp("carla"), Server()
    assert record(modules, server, folder, "--condition", "night") == 0
    return folder / "drive.mcap", server


def test_axes_turn_over(modules):
    conversions = modules.conversions
    assert conversions.position(Location(1, 2, 3)).tolist() == [1, -2, 3]

    def columns(**angles):
        return conversions.matrix(Location(), Rotation(**angles))[:3, :3].T.round(9).tolist()

    assert columns(yaw=90) == [[0, -1, 0], [1, 0, 0], [0, 0, 1]]  # to the right
    assert columns(pitch=90) == [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]  # the nose goes up
    assert columns(roll=90) == [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # the right side goes down, the left one up


def test_sensors_of_the_thesis(modules):
    specs, conversions = thesis_rig().specs, modules.conversions
    assert conversions.mount(specs["stereo_left"]) == ((2.0, -0.2, 1.0), (0.0, 0.0, 0.0))
    assert conversions.mount(specs["radar"]) == ((2.0, 0.0, 1.0), (5.0, 0.0, 0.0))  # looks up
    kind, own = conversions.blueprint(specs["camera"], 3)
    assert (kind, own["image_size_x"], own["image_size_y"], own["fov"]) == ("sensor.camera.rgb", "800", "600", "90.0")
    assert (own["lens_k"], own["lens_kcube"], own["lens_circle_multiplier"]) == ("0.0", "0.0", "0.0")
    kind, own = conversions.blueprint(specs["lidar"], 3)
    assert (kind, own["channels"], own["points_per_second"]) == ("sensor.lidar.ray_cast", "128", "1000000")
    assert (own["rotation_frequency"], own["upper_fov"], own["lower_fov"]) == ("20.0", "30.0", "-20.0")
    assert (own["range"], own["noise_stddev"], own["noise_seed"]) == ("100.0", "0.01", "3")
    kind, own = conversions.blueprint(specs["radar"], 3)
    assert (kind, own["horizontal_fov"], own["vertical_fov"]) == ("sensor.other.radar", "100.0", "50.0")


def test_weathers_of_the_city(modules):
    clear, rain, fog, night = (
        modules.conversions.weather(condition(name).weather) for name in ("clear", "rain", "fog", "night")
    )
    assert (clear["precipitation"], clear["fog_density"], clear["cloudiness"]) == (0, 0, 10)
    assert (clear["sun_altitude_angle"], clear["sun_azimuth_angle"]) == (45, 300)  # 60 degrees to the left
    assert (rain["precipitation"], rain["wetness"], rain["cloudiness"]) == (30, 30, 90)
    assert (fog["fog_density"], fog["precipitation"]) == (50, 0)
    assert (night["sun_altitude_angle"], night["cloudiness"]) == (-30, 10)
    assert modules.conversions.weather(condition("heavy-rain+dense-fog").weather)["fog_density"] == 100


def test_images(modules):
    raw = bytes([1, 2, 3, 255, 4, 5, 6, 255])  # blue, green, red, alpha
    assert modules.conversions.bgr(raw, (2, 1)).tolist() == [[[1, 2, 3], [4, 5, 6]]]
    raw = bytes([255, 255, 255, 255, 0, 1, 0, 255, 1, 0, 2, 255])
    got = modules.conversions.depths_m(raw, (3, 1))[0]
    assert got == pytest.approx([1000.0, 256 / 16777215 * 1000, (2 + 65536) / 16777215 * 1000])


def test_points(modules):
    raw = np.array([[1, 2, 3, 0.5], [4, -5, 6, 0.25], [7, 8, 9, 1]], np.float32).tobytes()
    xyz, intensity, ring = modules.conversions.points(raw, [2, 0, 1])
    assert xyz.tolist() == [[1, -2, 3], [4, 5, 6], [7, -8, 9]]
    assert (intensity.tolist(), ring.tolist()) == ([0.5, 0.25, 1], [0, 0, 2])
    assert modules.conversions.points(raw, [2, 0, 0])[2] is None  # a channel lacks points


def test_echoes(modules):
    right, up = np.radians([30, 45])
    raw = np.array([[-3, right, 0, 10], [2, 0, up, 2]], np.float32).tobytes()  # velocity, azimuth, altitude, depth
    got = modules.conversions.echoes(raw)
    assert got.xyz == pytest.approx(np.array([[8.660254, -5, 0], [1.414214, 0, 1.414214]]), abs=1e-5)
    assert (got.radial_velocity_mps.tolist(), got.range_m.tolist()) == ([-3, 2], [10, 2])
    assert (got.azimuth_rad, got.altitude_rad) == (pytest.approx([-right, 0]), pytest.approx([0, up]))


@pytest.mark.parametrize(("kind", "own", "label"), [
    ("vehicle.ford.ambulance", {"base_type": "van"}, "van"), ("vehicle.x", {"base_type": "Bus"}, "bus"),
    ("vehicle.old.bike", {"number_of_wheels": "2"}, "motorcycle"), ("vehicle.old", {"number_of_wheels": "4"}, "car"),
    ("vehicle.bh.crossbike", {"base_type": "bicycle", "number_of_wheels": "2"}, "bicycle"),
    ("walker.pedestrian.0012", {}, "pedestrian"),
])  # fmt: skip
def test_labels(modules, kind, own, label):
    assert modules.conversions.label(kind, own) == label


def test_boxes_of_actors(modules):
    found, size = modules.conversions.box(BoundingBox(Location(0.1, 0.2, 0.7), Vector3D(2, 1, 0.75)), "car")
    assert (found[:3, 3].tolist(), size.tolist()) == ([0.1, -0.2, 0.7], [4, 2, 1.5])
    broken = BoundingBox(Location(0, 194.3, 0.66), Vector3D(1.18, 0.0, 0.64))  # CARLA's issue 3670
    found, size = modules.conversions.box(broken, "bicycle")
    assert (found[:3, 3].tolist(), size.tolist()) == ([0, 0, 0.9], [1.7, 0.6, 1.8])


def test_rear_axle_from_centimeters(modules):
    world_T_body = modules.conversions.matrix(Location(10, 20, 0), Rotation(yaw=90))  # ahead is along CARLA's y
    wheels = [Vector3D(100 * (10 + x), 100 * (20 + y), 30) for y in (1.5, -1.4) for x in (-0.8, 0.8)]
    assert modules.conversions.rear_axle_m(wheels, world_T_body) == pytest.approx(-1.4)
    assert modules.conversions.rear_axle_m([Vector3D()] * 4, world_T_body) is None
    assert modules.conversions.rear_axle_m(wheels[:2], world_T_body) is None


def box_at(x, y, z=0.8):
    found = np.eye(4)
    found[:3, 3] = x, y, z
    return found


def test_visible_shares(modules):
    """Cars of 4 x 2 x 1.6 m around the eye: one in the open, one behind a wall, one half behind it, one unseen."""
    truth, px = modules.truth, 60
    faces = np.full((4, px, px), 500.0)
    faces[0, :, :30] = 18.0  # a wall 18 m ahead, from the middle to the left
    boxes = np.array([box_at(-20, 0), box_at(30, 4), box_at(30, 0)])
    faces[2] = 20.0  # something in the place of the first
    faces[0, :, 30:] = 30.0
    sizes = np.array([[4.0, 2, 1.6]] * 3)
    assert truth.visible_shares(boxes, sizes, faces) == pytest.approx([1, 0, 0.5], abs=0.03)
    assert truth.visible_shares(boxes[:1], sizes[:1], np.full((4, px, px), 500.0)).tolist() == [0]  # rays pass it


def test_ranges_of_depth_cameras(modules):
    faces = np.arange(1.0, 5.0)[:, None, None] * np.ones((4, 60, 60))  # 1 m ahead, 2 m to the left, 3 behind, 4 right
    faces[0, 0, 0] = 9.0  # top left
    s = np.sqrt(0.5)
    rays = np.array(
        [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0.8, 0.6, 0], [s, 0, s - 0.01], [0, 0, 1], [0.6, 0.59, 0.59]]
    )
    got = modules.truth.ranges_m(faces, rays / np.linalg.norm(rays, axis=1)[:, None])
    assert got == pytest.approx(
        [1, 2, 3, 4, 1.25, 1.404, np.nan, 9 * np.sqrt(0.6**2 + 2 * 0.59**2) / 0.6], abs=1e-3, nan_ok=True
    )


def test_points_in_boxes(modules):
    turned = modules.conversions.matrix(Location(10, 0, 0), Rotation(yaw=90))
    xyz = np.array([[10, 1.9, 0], [11.9, 0, 0], [10, -2.05, 0.5], [10, 2.2, 0]])
    sizes = np.array([[4.0, 2, 2], [4, 2, 2]])
    assert modules.truth.count_inside(np.array([turned, box_at(10, 0, 0)]), sizes, xyz).tolist() == [2, 1]


def test_outlines_of_lanes(modules):
    road, walk = modules.conversions.regions([stand_in.Waypoint(s) for s in (4.0, 0.0, 2.0)], 2.0)
    assert (road.kind, walk.kind) == ("road", "sidewalk")
    for region, (low, high) in ((road, (-2, 2)), (walk, (-4, -2))):  # y is to the left here
        assert sorted(region.points_m.tolist()) == [[0, low], [0, high], [6, low], [6, high]]
        (ax, ay), (bx, by), (cx, cy) = region.points_m[:3]
        assert (bx - ax) * (cy - by) - (by - ay) * (cx - bx) > 0  # counter-clockwise


def test_a_drive_is_whole(drive):
    path, server = drive
    reader = open_log(path, FaultLog())
    messages = list(reader.messages())
    kinds = {name: sum(m.sensor == name for m in messages) for name in ("camera", "lidar", "radar", "pose")}
    assert kinds == {"camera": 10, "lidar": 20, "radar": 20, "pose": 20}
    image = next(m for m in messages if isinstance(m, Image))
    assert cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_COLOR).shape == (120, 160, 3)
    assert {type(m) for m in messages} == {Image, PointCloud, RadarScan, Pose}
    poses = [m for m in messages if isinstance(m, Pose)]
    step = poses[-1].translation_m - poses[0].translation_m
    assert step[0] in (pytest.approx(8 * 0.95), pytest.approx(10 * 0.95))  # its lane's speed
    assert [m.stamp_ns - poses[0].stamp_ns for m in poses[:3]] == [0, 50_000_000, 100_000_000]
    assert {region.kind for region in reader.info.regions} == {"road", "sidewalk"}
    assert reader.info.metadata["rear_axle_x_m"] == "-1.400"
    assert server.weather.sun_altitude_angle == -30


def test_truth_is_where_the_sensors_see_it(drive):
    """Boxes are in fbench's axes: the points of LiDAR and radar lie in them, at the speed that radar measured."""
    reader = open_log(drive[0], FaultLog())
    truths = list(reader.truths())
    assert len(truths) == 10
    boxes = truths[0].boxes3d
    by_label = dict(zip(boxes.label, boxes.track_id, strict=True))
    assert set(by_label) >= {"car", "pedestrian"}
    parked = boxes[boxes.attribute == "parked"]
    assert (parked.track_id.tolist(), parked.source_label.tolist()) == ([1_000_000_000], ["ParkedCar_3"])
    assert abs(np.sin(parked.yaw_rad[0])) == pytest.approx(1)
    assert parked.size_lwh_m.tolist() == [[4.6, 2.0, 1.6]]
    pose = next(m for m in reader.messages() if isinstance(m, Pose))
    assert (parked.center_m[0] + pose.translation_m).round(6).tolist() == [30, 6, 0.8]  # in Unreal y is -6
    assert boxes.velocity_mps[boxes.label == "pedestrian"][0].tolist() == [1.5, 0, 0]
    seen = boxes[~boxes.ignore]
    assert len(seen) >= 3
    assert (seen.num_lidar_pts[seen.visibility > 0.5] > 5).all()
    assert seen.num_radar_pts.sum() > 0
    scan = next(m for m in reader.messages() if isinstance(m, RadarScan))
    ground = scan.xyz[np.abs(scan.xyz[:, 1]) < 1]
    assert len(ground)
    assert scan.radial_velocity_mps.min() < -7  # the road comes nearer as fast as we drive


def test_a_drive_checks_clean_and_replays(drive, tmp_path):
    path, _ = drive
    assert fbench("log", "check", path) == 0
    assert fbench("replay", path, "-p", "late3d", "-o", tmp_path / "run") == 0
    f1 = next(score for score in Run(tmp_path / "run").scores if score.metric == "f1")
    assert (f1.class_, f1.counts["fp"], f1.value > 0.5) == ("vehicle", 0, True)


def left(server):
    return (
        server.settings.synchronous_mode,
        server.settings.fixed_delta_seconds,
        server.traffic_is_synchronous,
        server.actors,
    )


def test_the_server_is_left_alone(drive):
    _, server = drive
    assert server.num_actors == 5 + 2 + 3 + 4  # vehicles, a walker and its controller, sensors, depth cameras
    assert left(server) == (False, None, False, {})


@pytest.mark.parametrize(("server", "arguments", "code", "text"), [
    (Server(is_there=False), (), 2, "no CARLA server answers at 127.0.0.1:2000; start it, or choose --host and --port"),
    (Server(version="0.9.15"), (), 2, "the server is CARLA 0.9.15, expected 0.9.16"),
    (Server(), ("Town3",), 2, "the server has no map 'Town3'; did you mean 'Town03'?"),
    (Server(busy_ports=(8000,)), (), 2, "port 8000 of the traffic manager is in use; choose --tm-port"),
    (Server(dies_at=110), (), 3, "CARLA at 127.0.0.1:2000: time-out of 5000ms while waiting for the simulator"),
    (Server(silent_at=110), ("--timeout-s", "0.05"), 3, "the server gave nothing of sensor 'camera' in step 110"),
    (Server(), ("--condition", "hail"), 2, "--condition hail: no condition 'hail'"),
    (Server(), ("--seconds", "0"), 2, "--seconds: expected between 0.1 and 86400, got 0"),
    (Server(), ("--seconds", "nan"), 2, "--seconds: expected between 0.1 and 86400, got nan"),
    (Server(), ("--timeout-s", "inf"), 2, "--timeout-s: expected between 0.001 and 86400, got inf"),
    (Server(), ("--warm-up-s", "inf"), 2, "--warm-up-s: expected between 0 and 3600, got inf"),
    (Server(), ("--vehicles", "-1"), 2, "--vehicles: expected between 0 and 10000, got -1"),
    (Server(), ("--vehicles", "-3"), 2, "--vehicles: expected between 0 and 10000, got -3"),
    (Server(), ("--pedestrians", "-1"), 2, "--pedestrians: expected between 0 and 10000, got -1"),
    (Server(), ("--port", "99999"), 2, "--port: expected between 1 and 65535, got 99999"),
    (Server(), ("--ego", "vehicle.tesla.model4"), 2,
     "--ego vehicle.tesla.model4: no vehicle of the server; did you mean 'vehicle.tesla.model3'?"),
    (Server(), ("--ego", "sensor.camera.rgb"), 2, "--ego sensor.camera.rgb: no vehicle of the server"),
    (Server(lacks="sensor.other.radar"), (), 3, "CARLA at 127.0.0.1:2000: blueprint 'sensor.other.radar' not found"),
])  # fmt: skip
def test_errors_are_one_line(modules, tmp_path, capsys, server, arguments, code, text):
    if arguments[:1] == ("Town3",):
        (tmp_path / "rig.toml").write_text(RIG)
        with pytest.MonkeyPatch.context() as patch:
            patch.setitem(sys.modules, "carla", stand_in.package(server))
            got = modules.record.main(["Town3", "-o", str(tmp_path / "drive.mcap")])
    else:
        got = record(modules, server, tmp_path, *arguments)
    err = capsys.readouterr().err
    assert (got, err.count("\n")) == (code, 1)
    assert err.startswith(f"record.py: {text}")
    assert sorted(path.name for path in tmp_path.iterdir()) in ([], ["rig.toml"])
    if server.is_there:
        assert left(server) == (False, None, False, {})


def test_without_the_package(modules, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "carla", None)
    assert modules.record.main(["Town03", "-o", str(tmp_path / "drive.mcap")]) == 2
    assert capsys.readouterr().err == "record.py: recording needs CARLA's client; pip install 'fbench[carla]'\n"


def test_rates_fit_the_ticks(modules, tmp_path, capsys):
    server = Server()
    (tmp_path / "slow.toml").write_text(RIG + "[lidars.slow]\ntranslation_m = [0.0, 0.0, 2.0]\nrate_hz = 10.0\n")
    assert record(modules, server, tmp_path, "--rig", tmp_path / "slow.toml") == 2
    assert "'slow': 10 Hz, but in CARLA it turns once a tick, which are 20 a second" in capsys.readouterr().err
    assert server.num_actors == 0


def test_interrupted(modules, tmp_path, capsys):
    server = Server(interrupted_at=110)
    assert record(modules, server, tmp_path) == 130
    assert "interrupted; the log is whole up to there" in capsys.readouterr().err
    assert fbench("log", "check", tmp_path / "drive.mcap") == 0
    poses = [m for m in open_log(tmp_path / "drive.mcap", FaultLog()).messages() if isinstance(m, Pose)]
    assert 3 <= len(poses) < 20
    assert left(server) == (False, None, False, {})


def test_interrupted_before_it_begins(modules, tmp_path, capsys):
    server = Server(interrupted_at=102)
    assert record(modules, server, tmp_path) == 130
    assert capsys.readouterr().err == "record.py: interrupted; nothing written\n"
    assert [path.name for path in tmp_path.iterdir()] == ["rig.toml"]
    assert left(server) == (False, None, False, {})


def test_an_existing_log_stays(modules, tmp_path, capsys):
    (tmp_path / "drive.mcap").write_bytes(b"mine")
    server = Server()
    assert record(modules, server, tmp_path) == 2
    assert "exists already" in capsys.readouterr().err
    assert (server.num_actors, (tmp_path / "drive.mcap").read_bytes()) == (0, b"mine")


@pytest.fixture(scope="module")
def package():
    return pytest.importorskip("carla", reason="CARLA's client isn't installed; pip install 'fbench[carla]'")


def public(kind):
    names = {name for base in kind.__mro__ if base.__module__ == stand_in.__name__ for name in vars(base)}
    fields = set(getattr(kind, "__dataclass_fields__", ()))
    return sorted(name for name in names | fields if not name.startswith("_"))


def parameters(function):
    """Signatures of a function of the package, by its documentation: names, and how many must be given."""
    for line in (function.__doc__ or "").splitlines():
        if match := re.match(r"\w+\((.*)\) -> ", line.strip()):
            names = re.findall(r"\(\w+\)(\w+)", match[1])
            yield names[1:], len(re.findall(r"\(\w+\)\w+", match[1].partition("[")[0])) - 1


KINDS = [*(getattr(stand_in, name) for name in stand_in.NAMES), stand_in.client_of(Server())]


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_the_stand_in_has_what_the_package_has(package, kind):
    real = getattr(package, kind.__name__)
    for name in public(kind):
        assert hasattr(real, name), f"{kind.__name__}.{name}"
        own = vars(kind).get(name)
        if inspect.isfunction(own):
            assert accepts(getattr(real, name), list(inspect.signature(own).parameters.values())[1:]), (
                f"{kind.__name__}.{name}"
            )
    if issubclass(kind, int):
        assert {one.name: (int(one), str(one)) for one in kind} == {
            one.name: (int(getattr(real, one.name)), str(getattr(real, one.name))) for one in kind
        }  # fmt: skip


def accepts(function, own):
    """Whether all calls that the stand-in takes are right for the package, too."""
    least = sum(p.default is p.empty for p in own)

    def same(p, name):
        return p.kind is p.POSITIONAL_ONLY if re.fullmatch(r"arg\d+", name) else p.name == name

    return any(
        needed <= least and len(own) <= len(names) and all(map(same, own, names))
        for names, needed in parameters(function)
    )


@pytest.mark.slow
def test_the_comparison_finds_what_differs(package):
    def tick(self, seconds, twice, /):
        pass

    assert not accepts(package.World.tick, list(inspect.signature(tick).parameters.values())[1:])
    assert not hasattr(package.World, "get_everything")


@pytest.mark.slow
def test_weather_and_sensor_data_have_the_packages_names(package, modules):
    assert all(
        hasattr(package.WeatherParameters(), name) for name in modules.conversions.weather(condition("fog").weather)
    )
    for kind, names in (("Image", ("width", "height", "raw_data")), ("RadarMeasurement", ("raw_data",)),
                        ("LidarMeasurement", ("channels", "get_point_count", "raw_data"))):  # fmt: skip
        assert all(hasattr(getattr(package, kind), name) for name in (*names, "frame"))
    turned, place = (
        package.Rotation(1.0, 2.0, 3.0),
        package.Location(1.0, 2.0, 3.0),
    )  # by position, as the recorder does
    assert ((turned.pitch, turned.yaw, turned.roll), (place.x, place.y, place.z)) == ((1, 2, 3), (1, 2, 3))
    assert package.Transform(place, turned).location == place
    settings = package.WorldSettings()
    settings.synchronous_mode, settings.fixed_delta_seconds = False, None


@pytest.mark.slow
@pytest.mark.parametrize("angles", [(10, 20, 30), (-40, 170, -5), (0, -90, 80)])
def test_rotations_are_the_packages(package, modules, angles):
    place = package.Transform(package.Location(1, 2, 3), package.Rotation(*angles))
    flip = np.diag([1.0, -1, 1, 1])
    expected = flip @ np.array(place.get_matrix()) @ flip
    assert modules.conversions.matrix(place.location, place.rotation) == pytest.approx(expected, abs=1e-6)


ROAD = """<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="4" name="" version="1"/>
<road name="r" length="50.0" id="1" junction="-1"><planView><geometry s="0" x="10" y="20" hdg="0" length="50.0"><line/>
</geometry></planView><elevationProfile><elevation s="0" a="0" b="0" c="0" d="0"/></elevationProfile><lateralProfile/>
<lanes><laneSection s="0"><center><lane id="0" type="none" level="false"/></center><right>
<lane id="-1" type="driving" level="false"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>
<lane id="-2" type="sidewalk" level="false"><width sOffset="0" a="2" b="0" c="0" d="0"/></lane>
</right></laneSection></lanes></road></OpenDRIVE>"""


@pytest.mark.slow
def test_outlines_of_a_map_of_the_package(package, modules):
    """OpenDRIVE's axes are fbench's: the right lanes of a road along x have the lower y."""
    waypoints = package.Map("road", ROAD).generate_waypoints(2.0)
    road, walk = modules.conversions.regions(waypoints, 2.0)
    for region, kind, (low, high) in ((road, "road", (16.5, 20)), (walk, "sidewalk", (14.5, 16.5))):
        assert region.kind == kind
        assert region.points_m.min(axis=0) == pytest.approx([10, low], abs=0.01)
        assert region.points_m[:, 1].max() == pytest.approx(high, abs=0.01)
        assert 60 <= region.points_m[:, 0].max() <= 62
