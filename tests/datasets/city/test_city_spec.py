from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fbench.datasets.city.request import CityRequest, read_rig
from fbench.datasets.city.rig import CameraSpec, LidarSpec, RigSpec, thesis_rig
from fbench.datasets.city.spec import CitySpec, Condition
from fbench.replay.conditions.weather import Weather
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.geometry.camera import project


def test_the_rig_is_that_of_the_thesis():
    spec = thesis_rig()
    rig = spec.rig()
    assert {name: mount.kind for name, mount in rig.mounts.items()} == {
        "camera": "camera", "stereo_left": "camera", "stereo_right": "camera", "lidar": "lidar", "radar": "radar",
    }  # fmt: skip
    assert rig.mounts["camera"].translation_m.tolist() == [2.0, 0.0, 1.0]
    baseline = rig.mounts["stereo_left"].translation_m - rig.mounts["stereo_right"].translation_m
    assert baseline.tolist() == pytest.approx([0, 0.4, 0])
    camera = rig.cameras["camera"]
    assert camera.size_wh == (800, 600)
    assert camera.K.tolist() == pytest.approx(np.array([[400, 0, 399.5], [0, 400, 299.5], [0, 0, 1]]))
    lidar = spec.lidars["lidar"]
    assert (lidar.channels, lidar.points_per_s / lidar.rate_hz, lidar.range_m) == (128, 50_000, 100)
    assert (lidar.upper_deg, lidar.lower_deg, lidar.noise_m) == (30, -20, 0.01)
    assert rig.mounts["lidar"].translation_m.tolist() == [0, 0, 2]
    radar = spec.radars["radar"]
    fov = (radar.horizontal_fov_deg, radar.vertical_fov_deg)
    assert (*fov, radar.points_per_s, radar.range_m) == (100, 50, 250_000, 100)


def test_cameras_look_ahead_and_the_radar_five_degrees_up():
    rig = thesis_rig().rig()
    ahead = rig.body_T_sensor("camera")[:3, :3] @ [0, 0, 1]
    assert ahead.tolist() == pytest.approx([1, 0, 0])
    pixel, depth = project(rig.cameras["camera"], np.array([[0.5, -0.25, 2.0]]))
    assert (pixel[0].tolist(), depth[0]) == (pytest.approx([499.5, 249.5]), 2.0)
    up = rig.body_T_sensor("radar")[:3, :3] @ [1, 0, 0]
    assert np.degrees(np.arcsin(up[2])) == pytest.approx(5)


def test_a_cameras_turn_is_about_the_bodys_axes():
    left = CameraSpec(translation_m=(0.0, 0.0, 0.0), yaw_pitch_roll_deg=(90.0, 0.0, 0.0))
    rig = RigSpec(cameras={"left": left}).rig()
    assert (rig.body_T_sensor("left")[:3, :3] @ [0, 0, 1]).tolist() == pytest.approx([0, 1, 0])


def test_ids_tell_specs_apart():
    base = CitySpec(seed=1)
    assert base.log_id == CitySpec(seed=1).log_id
    others = [
        CitySpec(seed=2),
        CitySpec("highway", seed=1),
        CitySpec(seed=1, seconds=5.0),
        CityRequest(seed=1, condition="fog").spec(),
        CityRequest(seed=1, settings=["weather.lux=10.0"]).spec(),
        CityRequest(seed=1, settings=["lidar.noise_m=0.02"]).spec(),
        CityRequest(seed=1, sensors=["lidar"]).spec(),
    ]
    assert len({spec.log_id for spec in (base, *others)}) == len(others) + 1


def test_equal_specs_have_equal_ids():
    whole, real = (CitySpec(condition=Condition("mine", Weather(rain_mm_h=rain))) for rain in (5, 5.0))
    assert whole == real
    assert whole.log_id == real.log_id
    assert whole.metadata == real.metadata


def test_metadata_say_what_was_simulated():
    metadata = CityRequest("highway", "rain+night", seed=5).spec().metadata
    assert (metadata["scenario"], metadata["condition"], metadata["seed"]) == ("highway", "rain+night", "5")
    assert (metadata["weather.rain_mm_h"], metadata["weather.lux"]) == ("15", "0.3")
    assert metadata["reference"] == "camera"
    assert CityRequest(sensors=["radar"]).spec().metadata["reference"] == "radar"


def test_choosing_sensors_keeps_all_else_of_a_rig(tmp_path):
    path = tmp_path / "rig.toml"
    text = "pose_rate_hz = 50.0\n" + "".join(
        f"[{kind}.{kind}]\ntranslation_m = [1, 0, 2]\n" for kind in ("cameras", "lidars", "radars")
    )
    path.write_text(text)
    whole, chosen = (CityRequest(rig_file=path, sensors=names).spec().rig for names in ((), ("radars", "cameras")))
    assert whole.names == ("cameras", "lidars", "radars")
    assert chosen.names == ("cameras", "radars")
    assert chosen == RigSpec(cameras=whole.cameras, radars=whole.radars, pose_rate_hz=50.0)


def test_settings_change_sensors_and_weather():
    spec = CityRequest(settings=["lidar.channels=64", "camera.size_wh=[400, 300]", "weather.rain_mm_h=7"]).spec()
    assert spec.rig.lidars["lidar"].channels == 64
    assert spec.rig.cameras["camera"].size_wh == (400, 300)
    assert spec.condition.weather.rain_mm_h == 7


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        (CityRequest(world="rural"), "no simulated world 'rural'"),
        (CityRequest(world="urbn"), r"did you mean 'urban'\?"),
        (CityRequest(seconds=0.0), "--seconds 0: expected 0.1 to 86400"),
        (CityRequest(seconds=float("nan")), "--seconds nan"),
        (CityRequest(seconds=1e9), "--seconds"),
        (CityRequest(seed=-1), "--seed -1"),
        (CityRequest(seed=2**63), "--seed"),
        (CityRequest(settings=["lidar"]), "expected NAME.FIELD=VALUE"),
        (CityRequest(settings=["lidar.channels"]), "expected NAME.FIELD=VALUE"),
        (CityRequest(settings=["lidr.channels=1"]), r"no sensor 'lidr'; did you mean 'lidar'\?"),
        (CityRequest(settings=["lidar.chanels=1"]), r"unknown key 'lidars.lidar.chanels'; did you mean 'channels'\?"),
        (CityRequest(settings=["lidar.channels=0"]), "lidars.lidar.channels: Input should be greater than"),
        (CityRequest(settings=["lidar.channels=many"]), "'many' isn't a value of TOML"),
        (CityRequest(settings=["lidar.channels=1\nseed=2"]), "isn't one value of TOML"),
        (CityRequest(settings=["lidar.noise_m=nan"]), "lidars.lidar.noise_m"),
        (CityRequest(settings=["lidar.phase_ms=50.0"]), "phase_ms must be below the period of 50 ms"),
        (CityRequest(settings=["camera.rate_hz=1.0", "camera.phase_ms=900.0"], seconds=0.5), "measures first after"),
        (CityRequest(settings=["camera.size_wh=[1, 1]"]), "size_wh must be 16 to 8192 px each"),
        (CityRequest(settings=["weather.snow=1"]), "no 'snow' in the weather"),
        (CityRequest(settings=["weather.lux=true"]), "expected a number"),
        (CityRequest(settings=["weather.visibility_m=-1"]), "visibility_m"),
        (CityRequest(sensors=["sonar"]), "--sensors sonar: fits no sensor"),
        (CityRequest(sensors=["!*"]), "leaves no sensor"),
        (CityRequest(rig_file=Path("absent.toml")), "absent.toml: no such file"),
    ],
)  # fmt: skip
def test_requests_that_cannot_be_are_one_line(asked, says):
    with pytest.raises(ConfigError, match=says):
        asked.spec()


RIG = """
pose_rate_hz = 50.0
[cameras.front]
translation_m = [1.5, 0, 1.4]
size_wh = [640, 480]
rate_hz = 15.0
[cameras.rear]
translation_m = [-1.0, 0.0, 1.4]
yaw_pitch_roll_deg = [180.0, 0.0, 0.0]
[lidars.top]
translation_m = [0, 0, 2.1]
channels = 64
motion = true
[radars.left]
translation_m = [3.0, 0.8, 0.5]
yaw_pitch_roll_deg = [60.0, 0.0, 0.0]
merge_cells = true
"""


def test_rigs_come_from_toml(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(RIG)
    spec = read_rig(path)
    assert spec.names == ("front", "left", "rear", "top")
    assert (spec.reference, spec.pose_rate_hz) == ("front", 50)
    assert (spec.cameras["front"].size_wh, spec.cameras["front"].rate_hz) == ((640, 480), 15)
    assert spec.lidars["top"] == LidarSpec(translation_m=(0.0, 0.0, 2.1), channels=64, motion=True)
    back = spec.rig().body_T_sensor("rear")[:3, :3] @ [0, 0, 1]
    assert back.tolist() == pytest.approx([-1, 0, 0])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no sensor in it"),
        ("[lidar.top]\ntranslation_m=[0,0,2]", r"unknown key 'lidar'; did you mean 'lidars'\?"),
        ("[lidars.top]", "lidars.top.translation_m: Field required"),
        ("[lidars.top]\ntranslation_m=[0,0]", "lidars.top.translation_m"),
        ("[lidars.top]\ntranslation_m=[0,0,inf]", "lidars.top.translation_m.2"),
        ("[lidars.top]\ntranslation_m='here'", "lidars.top.translation_m"),
        ("[lidars.'a b']\ntranslation_m=[0,0,2]", "lidars.a b"),
        ("[lidars.pose]\ntranslation_m=[0,0,2]", "two streams are called 'pose'"),
        ("[lidars.body]\ntranslation_m=[0,0,2]", "'body', which is a coordinate frame"),
        ("[cameras.map]\ntranslation_m=[0,0,2]", "'map', which is a coordinate frame"),
        ("[radars.weather]\ntranslation_m=[0,0,2]", "'weather', which --set takes for the weather"),
        ("[lidars.top]\ntranslaton_m=[0,0,2]", r"'lidars.top.translaton_m'; did you mean 'translation_m'\?"),
        ("[lidars.top]", "Field required$"),
        ("[lidars.a]\ntranslation_m=[0,0,2]\n[radars.a]\ntranslation_m=[0,0,2]", "two streams are called 'a'"),
        ("[cameras.a]\ntranslation_m=[0,0,2]\nfov_deg=180.0", "cameras.a.fov_deg"),
        ("lidars = 3", "lidars: Input should be"),
        ("[lidars", "isn't TOML"),
        ("[lidars.a]\ntranslation_m=[0,0,2]\nrate_hz=0.0", "rate_hz"),
        ("[lidars.a]\ntranslation_m=[0,0,2]\nloss=1.5", "loss"),
    ],
)  # fmt: skip
def test_rig_files_that_are_wrong_name_the_key(tmp_path, text, says):
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=says):
        read_rig(path)


def test_files_that_are_no_rigs_are_refused(tmp_path):
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "large.toml").write_bytes(b"#" * 2_000_000)
    for name, says in (("binary.toml", "isn't TOML"), ("large.toml", "which no rig takes"), (".", "is a folder")):
        with pytest.raises(ConfigError, match=says):
            read_rig(tmp_path / name)


def test_a_spec_without_sensors_is_refused():
    with pytest.raises(ConfigError, match="the rig has no sensor"):
        replace(CitySpec(), rig=RigSpec())
