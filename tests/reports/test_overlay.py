"""Overlays, read by MCAP's own reader and decoded by the schemas that the files carry."""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from tests.reports.conftest import RIG, Plan, boxes2d, boxes3d
from tests.reports.test_safety import HOSTILE, hostile_plan

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.messages import PointCloud
from fbench.replay.data.rig import LogInfo
from fbench.replay.logs.containers.mcap.write import McapWriter
from fbench.replay.logs.open import open_container
from fbench.replay.runs.folder import FRAMES, Run, write_frames
from fbench.reports.overlay.file import Names, write_overlay

MakeRun = Callable[[Plan], Run]
Messages = Mapping[str, list[Any]]


def read(path: Path) -> Messages:
    """Messages by topic, decoded by what the file says of their schemas."""
    found: dict[str, list[Any]] = {}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, _, proto in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append(proto)
    return found


def with_poses(run: Run) -> Run:
    """Drive 2 m a frame along x of the world, heading along its y axis."""
    half = math.sqrt(0.5)
    poses = np.array([[100.0 + 2 * i, 50, 0, 0, 0, half, half] for i in range(len(run.frames))])
    write_frames(run.folder / FRAMES, run.frames, poses)
    return Run(run.folder)


@pytest.fixture
def overlay(make_run: MakeRun, tmp_path: Path) -> Messages:
    run = with_poses(make_run(Plan(missing={"radar": "no message"}, failed="division by zero")))
    outcomes = {"truth": {(0, ""): "hit", (1, ""): "missed"}, "detections": {(0, ""): "hit", (1, ""): "false alarm"}}
    write_overlay(run, outcomes, tmp_path / "overlay.mcap")
    return read(tmp_path / "overlay.mcap")


def colour(primitive: Any) -> tuple[float, float, float]:
    color = primitive.color
    return round(color.r, 2), round(color.g, 2), round(color.b, 2)


def test_boxes_are_cubes_with_speed_and_distance(overlay: Messages) -> None:
    """The box is 10 m ahead, 4 x 2 x 2 m, and drives with (3, 4) m/s."""
    scenes = overlay["/fbench/tracks"]
    assert [scene.DESCRIPTOR.full_name for scene in scenes] == ["foxglove.SceneUpdate"] * 4
    (entity,) = scenes[0].entities
    (cube,), (arrow,), (text,) = entity.cubes, entity.arrows, entity.texts
    place, size, turn = cube.pose.position, cube.size, cube.pose.orientation
    assert (entity.frame_id, (place.x, place.y, place.z)) == ("body", (10, 0, 0))
    assert ((size.x, size.y, size.z), (turn.x, turn.y, turn.z, turn.w)) == ((4, 2, 2), (0, 0, 0, 1))
    assert text.text == "car #7 10.0 m 5.0 m/s LR 0.88"
    assert (text.pose.position.z, text.billboard) == (1.5, True)
    assert arrow.shaft_length == 5
    assert 2 * math.atan2(arrow.pose.orientation.z, arrow.pose.orientation.w) == pytest.approx(math.atan2(4, 3))
    values = {pair.key: pair.value for pair in entity.metadata}
    assert values == {
        "class": "car", "id": "7", "score": "0.875", "distance_m": "10.0", "speed_mps": "5.0", "sources": "LR",
        "predicted": "False", "row": "0", "outcome": "",
    }  # fmt: skip


def test_each_message_replaces_the_one_before(overlay: Messages) -> None:
    for topic in ("/fbench/truth", "/fbench/detections", "/fbench/tracks", "/fbench/trails"):
        assert [[d.type for d in scene.deletions] for scene in overlay[topic]] == [[1]] * 4
    assert [len(scene.entities) for scene in overlay["/fbench/detections"]] == [1, 1, 0, 1]  # frame 2 failed


def test_colors_tell_hits_misses_and_false_alarms_apart(overlay: Messages) -> None:
    truth, found = ([scene.entities[0].cubes[0] for scene in overlay[f"/fbench/{side}"][:2]]
                    for side in ("truth", "detections"))  # fmt: skip
    assert colour(truth[0]) == colour(found[0])  # both hit
    assert len({colour(cube) for cube in (truth[0], truth[1], found[1])}) == 3
    outlines = [message.points[0].outline_color for message in overlay["/fbench/detections/cam"][:2]]
    assert [(round(c.r, 2), round(c.g, 2), round(c.b, 2)) for c in outlines] == [colour(cube) for cube in found]


def test_rectangles_in_images_count_from_the_corner_of_the_first_pixel(make_run: MakeRun, tmp_path: Path) -> None:
    """The box spans pixel centers 10 to 50 and 20 to 60; 25 m away and 1.5 m/s nearing."""
    write_overlay(make_run(Plan(make_boxes=boxes2d)), {}, tmp_path / "o.mcap")
    annotations = read(tmp_path / "o.mcap")["/fbench/detections/cam"][0]
    assert annotations.DESCRIPTOR.full_name == "foxglove.ImageAnnotations"
    (outline,), (text,) = annotations.points, annotations.texts
    assert outline.type == 2  # LINE_LOOP
    assert [(p.x, p.y) for p in outline.points] == [(10.5, 20.5), (50.5, 20.5), (50.5, 60.5), (10.5, 60.5)]
    assert text.text == "car #3 25.0 m -1.5 m/s C 0.50"
    (entity,) = read(tmp_path / "o.mcap")["/fbench/detections"][0].entities
    place = entity.spheres[0].pose.position
    assert math.hypot(place.x, place.y, place.z) == pytest.approx(25)


def test_boxes_in_space_are_outlined_in_cameras(overlay: Messages) -> None:
    """f = 100 px, the near face is 8 m ahead and 2 m wide: 25 px around the center 79.5."""
    points = overlay["/fbench/truth/cam"][0].points[0].points
    assert [p.x for p in points] == pytest.approx([67.5, 92.5, 92.5, 67.5])


def test_transforms_place_body_and_sensors(overlay: Messages) -> None:
    first, second, third, _ = overlay["/fbench/transforms"]
    names = [(t.parent_frame_id, t.child_frame_id) for t in first.transforms]
    assert names == [("world", "body"), ("body", "cam"), ("body", "radar"), ("body", "top")]
    assert [len(message.transforms) for message in (second, third)] == [1, 4]  # the third begins a segment
    place, turn = second.transforms[0].translation, second.transforms[0].rotation
    assert ((place.x, place.y), turn.z) == ((102, 50), pytest.approx(math.sqrt(0.5)))


def test_trails_are_in_the_world_and_end_with_the_segment(overlay: Messages) -> None:
    """10 m ahead of a body that heads along y."""
    scenes = overlay["/fbench/trails"]
    (line,) = scenes[1].entities[0].lines
    assert scenes[1].entities[0].frame_id == "world"
    assert [(round(p.x, 6), round(p.y, 6)) for p in line.points] == [(100, 60), (102, 60)]
    assert len(scenes[3].entities[0].lines[0].points) == 1  # after the border, and the frame without tracks


def test_notes_say_what_was_missing_and_failed(overlay: Messages) -> None:
    notes = [(note.name, note.level, note.message) for note in overlay["/fbench/log"]]
    assert notes == [
        ("frame 1", 3, "radar is missing: no message"), ("frame 2", 4, "pipeline failed: division by zero"),
    ]  # fmt: skip


def test_equal_runs_give_equal_bytes(make_run: MakeRun, tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_overlay(make_run(Plan(name=name)), {}, tmp_path / f"{name}.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    assert (tmp_path / "a.layout.json").read_bytes() == (tmp_path / "b.layout.json").read_bytes()


def raw(path: Path) -> dict[str, list[tuple[int, int, bytes]]]:
    """Messages by topic, with their times, as they are."""
    found: dict[str, list[tuple[int, int, bytes]]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            found.setdefault(channel.topic, []).append((message.log_time, message.publish_time, message.data))
    return found


def write_log(path: Path) -> None:
    with McapWriter(path, LogInfo("street", "id-1", {}), RIG) as writer:
        for index in range(4):
            stamp_ns = index * 100_000_000
            writer.write(PointCloud("top", stamp_ns, stamp_ns + 50_000_000, np.ones((3, 3), np.float32)))


def test_messages_of_the_log_are_copied_in_order(make_run: MakeRun, tmp_path: Path) -> None:
    write_log(tmp_path / "log.mcap")
    log = open_container(tmp_path / "log.mcap", FaultLog())
    write_overlay(make_run(Plan()), {}, tmp_path / "both.mcap", log)
    own, both = raw(tmp_path / "log.mcap"), raw(tmp_path / "both.mcap")
    assert {topic: both[topic] for topic in own} == own
    assert "/fbench/tracks" in both
    with (tmp_path / "both.mcap").open("rb") as file:
        times = [message.log_time for _, _, message in make_reader(file).iter_messages(log_time_order=False)]
    assert times == sorted(times)
    with pytest.raises(ConfigError, match="is the log itself"):
        write_overlay(make_run(Plan(name="other")), {}, tmp_path / "log.mcap", log)
    assert raw(tmp_path / "log.mcap") == own


def test_layout_names_topics_that_are_there(make_run: MakeRun, tmp_path: Path) -> None:
    write_log(tmp_path / "log.mcap")
    log = open_container(tmp_path / "log.mcap", FaultLog())
    _, path = write_overlay(with_poses(make_run(Plan(failed="x"))), {}, tmp_path / "o.mcap", log)
    topics, content = set(read(tmp_path / "o.mcap")), json.loads(path.read_text("utf-8"))
    panels = content["configById"]
    assert set(panels["3D!scene"]["topics"]) <= topics
    mode = panels["Image!camera0"]["imageMode"]
    assert {*mode["annotations"], mode["calibrationTopic"], panels["RosOut!notes"]["topicToRender"]} <= topics
    shown = json.dumps(content["layout"])
    assert all(f'"{name}"' in shown for name in panels)


def test_boxes_that_are_not_finite_are_left_out(make_run: MakeRun, tmp_path: Path) -> None:
    bad = replace(boxes3d(), center_m=np.array([[np.nan, 0, 0]]))
    write_overlay(make_run(Plan(make_boxes=lambda _: bad)), {}, tmp_path / "o.mcap")
    assert not any(scene.entities for scene in read(tmp_path / "o.mcap")["/fbench/tracks"])


def test_runs_without_truth_have_no_truth(make_run: MakeRun, tmp_path: Path) -> None:
    _, path = write_overlay(make_run(Plan(truth=False)), {}, tmp_path / "o.mcap")
    assert not [topic for topic in read(tmp_path / "o.mcap") if "truth" in topic]
    assert "truth" not in path.read_text("utf-8")


def test_logs_of_others_keep_their_coordinate_frames(make_run: MakeRun, tmp_path: Path) -> None:
    _, path = write_overlay(with_poses(make_run(Plan())), {}, tmp_path / "o.mcap", names=Names("base_link", "odom"))
    messages = read(tmp_path / "o.mcap")
    assert "/fbench/transforms" not in messages
    frames = {topic: messages[topic][0].entities[0].frame_id for topic in ("/fbench/tracks", "/fbench/trails")}
    assert frames == {"/fbench/tracks": "base_link", "/fbench/trails": "odom"}
    assert json.loads(path.read_text("utf-8"))["configById"]["3D!scene"]["followTf"] == "base_link"


def test_hostile_names_of_sensors(make_run: MakeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are topics, coordinate frames, and keys of the layout."""
    names = {name: f"{name}{HOSTILE[:50]}\x1b[2J" for name in RIG.mounts}
    mounts = {names[name]: mount for name, mount in RIG.mounts.items()}
    rig = replace(RIG, mounts=mounts, cameras={names["cam"]: RIG.cameras["cam"]})
    monkeypatch.setattr("tests.reports.conftest.RIG", rig)
    _, path = write_overlay(make_run(Plan()), {}, tmp_path / "o.mcap")
    messages = read(tmp_path / "o.mcap")
    frames = [t.child_frame_id for message in messages["/fbench/transforms"] for t in message.transforms]
    assert len(frames) == 6
    assert all(c.isprintable() for text in [*messages, *frames] for c in text)
    assert len([topic for topic in messages if topic.startswith("/fbench/truth/cam</script>")]) == 1
    panels = json.loads(path.read_text("utf-8"))["configById"]
    assert set(panels["Image!camera0"]["imageMode"]["annotations"]) <= set(messages)


@pytest.mark.parametrize("boxes", [boxes2d, boxes3d])
def test_hostile_text_is_shown_and_does_nothing(make_run: MakeRun, tmp_path: Path, boxes: Any) -> None:
    _, path = write_overlay(make_run(replace(hostile_plan(), make_boxes=boxes)), {}, tmp_path / "o.mcap")
    messages = read(tmp_path / "o.mcap")
    texts = [note.message for note in messages["/fbench/log"]]
    texts += [text.text for scene in messages["/fbench/truth"] for e in scene.entities for text in e.texts]
    texts += [pair.value for scene in messages["/fbench/truth"] for e in scene.entities for pair in e.metadata]
    assert any(text.startswith(HOSTILE[:20]) for text in texts)  # shown
    assert all(character.isprintable() for text in [*texts, *messages] for character in text)
    assert max(map(len, texts)) < 120
    json.loads(path.read_text("utf-8"))
