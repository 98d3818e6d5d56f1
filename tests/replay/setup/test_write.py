"""Whatever is in a name, the file is read back as it was meant."""

import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.replay.setup import drive as d

from fbench.replay.setup.configuration import Config
from fbench.replay.setup.guess_sensors import find_stems, name_sensors
from fbench.replay.setup.init import write_toml
from fbench.replay.setup.inspection import Draft, LeftOut, Line, Table

names = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=20)
nasty = st.sampled_from(
    ['a"b', "x\ny = 1", "]", "[classes]", "\\", "#", "Köln 🚗", "a.b", "\x7f\x00\x1b", "'", "\u2028"]
)


@given(names | nasty, names | nasty, names | nasty)
def test_names_are_read_back(key, value, why):
    lines = (Line("topic", value, why, is_guess=True), Line("kind", "lidar", why))
    off = Table(("sensors", key + "2"), lines, (why,), is_active=False)
    tables = (Table(("sensors", key), lines, (why,)), off, Table(("classes",), (Line(key, "car", why),)))
    text = write_toml(Draft(value, tables, (LeftOut(value, why),))).text
    config = Config.model_validate(tomllib.loads(text))
    assert {name: sensor.topic for name, sensor in config.sensors.items()} == {key: value}
    assert config.classes == {key: "car"}


def test_lines_to_look_at_are_where_they_are_said_to_be():
    lines = (
        Line("timeout_ms", 30.0),
        Line("stamps", "log", "odd", is_guess=True),
        Line("max_gap_s", 2.0, is_guess=True),
    )
    written = write_toml(Draft("log", (Table(("frames",), lines),)))
    rows = written.text.splitlines()
    assert [rows[place.number - 1].split(" = ")[0] for place in written.guesses] == ["stamps", "max_gap_s"]
    assert f"#   {written.guesses[0].number}: frames.stamps" in rows
    assert 'stamps = "log"  # guess: odd; check it' in rows
    assert "max_gap_s = 2.0  # guess; check it" in rows


def test_hostile_topics_and_labels_in_a_log(guess):
    topics = ['/a"]\n[body]\nframe = "x', "/ü/[b]/points", "/x'#y/points", "/" + "z" * 300]
    log = d.Drive()
    for _, ns in d.steps(3, 100):
        for topic in topics:
            log.add(topic, ns, d.points("base_link", ns))
        log.add("/gt", ns, d.boxes(ns, ['"\n[x]', "a]", "\\"]))
    config, text = guess(log)
    assert sorted(s.topic for s in config.sensors.values()) == sorted(topics[:3])
    assert config.body.frame == "base_link"
    assert set(config.classes) == {'"\n[x]', "a]", "\\"}
    assert "at most 200 are read" in text


@pytest.mark.parametrize(
    ("topic", "kind", "name"),
    [
        ("/sensing/lidar/top/pointcloud_raw", "lidar", "lidar_top"),
        ("/camera/front/image_raw/compressed", "camera", "camera_front"),
        ("/CAM_FRONT/image_rect_compressed", "camera", "cam_front"),
        ("/velodyne_points", "lidar", "velodyne"),
        ("/LIDAR_TOP", "lidar", "lidar_top"),
        ("/front/scan", "radar", "radar_front"),
        ("/points", "lidar", "lidar"),
        ("/車", "camera", "camera"),
    ],
)
def test_names_of_sensors(topic, kind, name):
    assert name_sensors({topic: kind}, find_stems([topic])) == {topic: name}


def test_what_all_topics_begin_with_is_no_part_of_names():
    kinds = {"/car7/lidar/points": "lidar", "/car7/left/image_raw": "camera"}
    assert list(name_sensors(kinds, find_stems(list(kinds))).values()) == ["camera_left", "lidar"]


@given(st.lists(names, unique=True, min_size=1, max_size=6))
def test_names_are_unique_and_plain(topics):
    found = name_sensors(dict.fromkeys(topics, "lidar"), find_stems(topics))
    assert len(set(found.values())) == len(topics)
    assert all(name.replace("_", "").isalnum() and name.isascii() for name in found.values())
