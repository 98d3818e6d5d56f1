"""Folders, tables and files that can't be used: one line each that names what is wrong."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fbench.datasets.importing.run import import_one
from fbench.datasets.nuscenes import NuScenes, NuScenesParams
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.importing import BadInput, FrameRange, ImportRequest
from fbench.replay.data.images import encode_jpeg
from fbench.replay.logs.open import open_log

FIRST, DEFAULTS = ImportRequest(("scene-0001",)), NuScenesParams()


def refused(source: Path, message: str, asked: ImportRequest = FIRST, params: NuScenesParams = DEFAULTS) -> None:
    out = source.parent / "out.mcap"
    with pytest.raises((LogError, ConfigError), match=message) as caught:
        import_one(NuScenes(params), source, out, asked)
    assert "\n" not in str(caught.value)
    assert not out.exists()


def test_folders(tmp_path: Path) -> None:
    refused(tmp_path / "none", r"none: no such folder$")
    refused(tmp_path, r"not a nuScenes folder, no folder such as v1.0-mini and no scene.json$")
    (tmp_path / "v1.0-mini").mkdir()
    refused(tmp_path, r"v1.0-mini/scene.json: no such table$")


def test_versions(nuscenes) -> None:
    (nuscenes.root / "v1.0-trainval").mkdir()
    refused(nuscenes.root, r"several versions, choose one with --set version=NAME: v1.0-mini, v1.0-trainval$")
    chosen = NuScenes(NuScenesParams(version="v1.0-mini"))
    assert len(chosen.names(nuscenes.root)) == 2
    refused(nuscenes.root, "no version 'v1.0-test'; there are", params=NuScenesParams(version="v1.0-test"))
    other = NuScenesParams(version="v1.0-trainval")
    refused(nuscenes.root / "v1.0-mini", "no version 'v1.0-trainval'; there are: v1.0-mini", params=other)


@pytest.mark.parametrize(
    "table",
    ["scene", "sample", "sample_data", "ego_pose", "calibrated_sensor", "sensor", "sample_annotation", "instance",
     "category", "attribute", "visibility", "log"],
)  # fmt: skip
def test_missing_and_broken_tables(nuscenes, table: str) -> None:
    path = nuscenes.root / f"v1.0-mini/{table}.json"
    path.write_text('{"token": 1}')
    refused(nuscenes.root, rf"{table}.json: isn't a table")
    path.write_text("[{}]")
    expected = (
        "sample_token 'None'" if table in ("sample_data", "sample_annotation") else "token is wrong .Field required"
    )
    if table != "ego_pose":  # whose rows nobody needs that nobody names
        refused(nuscenes.root, rf"{table}.json: row with token 'None': {expected}")
    path.unlink()
    refused(nuscenes.root, rf"{table}.json: no such table$")


def test_scenes(nuscenes) -> None:
    refused(nuscenes.root, "scene.json: no scene 'scene-0007'; did you mean", ImportRequest(("scene-0007",)))
    nuscenes.rows["scene"][1]["name"] = "scene-0001"
    nuscenes.write()
    refused(nuscenes.root, "scene.json: two scenes are called 'scene-0001', only one of them may be there$")
    nuscenes.rows["scene"] = []
    nuscenes.write()
    refused(nuscenes.root, "scene.json: no scenes$")


Rows = dict[str, list[dict[str, Any]]]
Edit = Callable[[Rows], None]


def _set(table: str, row: int, name: str, value: object) -> Edit:
    return lambda rows: rows[table][row].update({name: value})


def _copied(table: str, row: int, name: str = "", value: object = None) -> Edit:
    return lambda rows: rows[table].append({**rows[table][row], **({name: value} if name else {})})


def _linked(table: str, row: int, other: int, *names: str) -> Edit:
    """Let a row link another one of its table."""
    return lambda rows: rows[table][row].update(dict.fromkeys(names, rows[table][other]["token"]))


def _without_lidar(rows: Rows) -> None:
    keys = (row for row in rows["sample_data"] if "LIDAR" in row["filename"] and row["is_key_frame"])
    rows["sample_data"].remove(next(keys))


CHANGES = {
    "unknown first sample": (
        _set("scene", 0, "first_sample_token", "gone"),
        "sample.json: no sample 'gone', which scene-0001 has",
    ),
    "another last sample": (_set("scene", 0, "last_sample_token", "x"), "scene-0001 links 6 of its 6 samples"),
    "another number of samples": (
        _set("scene", 0, "nbr_samples", 7),
        "links 6 of its 6 samples .*, expected 7 that end",
    ),
    "an unlinked sample": (_copied("sample", 0, "token", "more"), "scene-0001 links 6 of its 7 samples"),
    "a chain that breaks": (_set("sample", 2, "next", "gone"), "sample.json: no sample 'gone', which scene-0001 has"),
    "a chain that is cut": (_set("sample", 2, "next", ""), "scene-0001 links 3 of its 6 samples"),
    "a chain that loops": (
        _linked("sample", 2, 0, "next"),
        "follows '', but is next of",
    ),
    "a chain that leaves": (
        _linked("sample", 2, 6, "next"),
        "is of another scene than scene-0001",
    ),
    "a chain that runs back": (_set("sample", 3, "timestamp", 5), "isn't later than '.*', of which it is next"),
    "two samples of one token": (_copied("sample", 0), "sample.json: two rows have the token"),
    "no drive": (_set("scene", 0, "log_token", "gone"), "log.json: no row with token 'gone', which scene-0001 names"),
    "data of no sample": (
        _set("sample_data", 0, "sample_token", "gone"),
        "sample_data.json: row with token .* 'gone', which isn't in",
    ),
    "no calibration": (
        _set("sample_data", 0, "calibrated_sensor_token", "gone"),
        "calibrated_sensor.json: no row with token 'gone'",
    ),
    "no sensor": (_set("calibrated_sensor", 0, "sensor_token", "gone"), "sensor.json: no row with token 'gone'"),
    "no pose": (
        _set("sample_data", 0, "ego_pose_token", "gone"),
        "ego_pose.json: no row with token 'gone', which sample_data",
    ),
    "two poses of one token": (_copied("ego_pose", 0), "ego_pose.json: two rows have the token"),
    "no LiDAR": (
        _without_lidar,
        "sample_data.json: sample '.*' has no keyframe of LIDAR_TOP",
    ),
    "two keyframes": (_copied("sample_data", 0, "token", "twice"), "'twice': a second CAM_FRONT of sample"),
    "a stamp that is none": (
        _set("sample_data", 0, "timestamp", -1),
        "timestamp is wrong .Input should be greater than or equal",
    ),
    "a huge stamp": (_set("sample_data", 0, "timestamp", 10**30), "row with token .*: timestamp is wrong"),
    "images without size": (
        lambda rows: [row.update(width=0) for row in rows["sample_data"]],
        "an image of CAM_FRONT without width and height",
    ),
    "images of two sizes": (_set("sample_data", 0, "width", 9), "8x6 px, expected 9x6 as the calibration says"),
    "a file outside": (
        _set("sample_data", 0, "filename", "../../etc/passwd"),
        "filename '../../etc/passwd' isn't a name within",
    ),
    "an absolute file": (
        _set("sample_data", 0, "filename", "/etc/passwd"),
        "filename '/etc/passwd' isn't a name within",
    ),
    "a file that isn't text": (_set("sample_data", 0, "filename", "\ud800"), "filename is wrong .*unicode"),
    "a description that isn't text": (_set("scene", 0, "description", "\ud800"), "description is wrong .*unicode"),
    "a missing file": (_set("sample_data", 0, "filename", "samples/none.jpg"), "samples/none.jpg: No such file"),
    "no intrinsics": (_set("calibrated_sensor", 2, "camera_intrinsic", []), "camera_intrinsic isn't that of CAM_FRONT"),
    "intrinsics that aren't": (
        _set("calibrated_sensor", 2, "camera_intrinsic", [[1, 0, 0], [0, -1, 0], [0, 0, 1]]),
        "isn't that of CAM_FRONT",
    ),
    "a mount that isn't": (
        _set("calibrated_sensor", 0, "rotation", [1, 1, 0, 0]),
        "rotation is wrong .*isn't a unit quaternion",
    ),
    "a pose that isn't": (
        _set("ego_pose", 0, "rotation", [0, 0, 0, 0]),
        "ego_pose.json: row .*isn't a unit quaternion",
    ),
    "an unknown modality": (
        _set("sensor", 0, "modality", "sonar"),
        "sensor.json: row .*: modality is wrong .Input should be",
    ),
    "a box of no sample": (
        _set("sample_annotation", 0, "sample_token", "gone"),
        "sample_annotation.json: row .* 'gone', which isn't in",
    ),
    "a box of nothing": (_set("sample_annotation", 0, "instance_token", "gone"), "instance.json: no row with token"),
    "an object of no category": (
        _set("instance", 0, "category_token", "gone"),
        "category.json: no row with token 'gone'",
    ),
    "an unknown attribute": (
        _set("sample_annotation", 0, "attribute_tokens", ["gone"]),
        "attribute.json: no row with token 'gone'",
    ),
    "an unknown visibility": (
        _set("sample_annotation", 0, "visibility_token", "9"),
        "visibility.json: no row with token '9'",
    ),
    "a visibility that isn't": (
        _set("visibility", 0, "level", "a bit"),
        "visibility.json: level 'a bit' isn't such as",
    ),
    "a box without size": (
        _set("sample_annotation", 0, "size", [1, 0, 1]),
        "size.1 is wrong .Input should be greater than 0",
    ),
    "a box nowhere": (
        _set("sample_annotation", 0, "translation", [1, float("nan"), 1]),
        "translation.1 is wrong .Input should be",
    ),
    "a box that links nowhere": (
        _set("sample_annotation", 0, "next", "gone"),
        "next is 'gone', which isn't in the scene",
    ),
    "a box that links another": (
        _linked("sample_annotation", 0, 2, "next"),
        "which doesn't link back, or is of another instance",
    ),
    "a box that links itself": (
        _linked("sample_annotation", 0, 0, "next", "prev"),
        "which isn't earlier",
    ),
    "two boxes of one token": (_copied("sample_annotation", 0), "sample_annotation.json: two rows have the token"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_tables_that_disagree(nuscenes, name: str) -> None:
    change, message = CHANGES[name]
    change(nuscenes.rows)
    nuscenes.write()
    refused(nuscenes.root, message)


@pytest.mark.parametrize(
    ("channel", "content", "message"),
    [
        ("CAM_FRONT", b"no picture", r"jpg: neither a JPEG nor a PNG"),
        ("CAM_FRONT", encode_jpeg(np.zeros((5, 8, 3), np.uint8)), r"jpg: 8x5 px, expected 8x6 as the calibration says"),
        ("CAM_FRONT", encode_jpeg(np.zeros((6, 8, 3), np.uint8))[:-9], r"jpg: the image has no end, is it truncated"),
        ("LIDAR_TOP", bytes(39), r"pcd.bin: 39 bytes aren't whole rows of 5 float32, is it truncated"),
        ("LIDAR_TOP", np.full(5, np.nan, "<f4").tobytes(), r"pcd.bin: rings aren't numbers from 0 to 65535"),
        ("RADAR_FRONT", b"", r"RADAR_FRONT.*pcd: not a PCD file, or its header is truncated"),
    ],
)  # fmt: skip
def test_broken_files(nuscenes, channel: str, content: bytes, message: str) -> None:
    row = next(r for r in nuscenes.rows["sample_data"] if channel in r["filename"])
    (nuscenes.root / row["filename"]).write_bytes(content)
    refused(nuscenes.root, message)


def test_bad_input_is_skipped_and_counted(nuscenes) -> None:
    for change in ("an unknown visibility", "data of no sample"):
        CHANGES[change][0](nuscenes.rows)
    nuscenes.rows["ego_pose"].pop(3)
    for channel in ("LIDAR_TOP", "RADAR_FRONT"):
        row = next(r for r in nuscenes.rows["sample_data"] if channel in r["filename"] and not r["is_key_frame"])
        (nuscenes.root / row["filename"]).unlink()
    nuscenes.write()
    bad = BadInput(skip=True)
    out = nuscenes.root.parent / "out.mcap"
    import_one(NuScenes(), nuscenes.root, out, ImportRequest(("scene-0001",), FrameRange(), bad))
    assert bad.num == 5
    reader = open_log(out, FaultLog())
    num = dict(reader.num_messages)
    assert num["LIDAR_TOP"] == 12
    assert num["RADAR_FRONT"] == 11
    assert [len(truth.boxes3d) for truth in reader.truths()] == [0, 1, 2, 4, 3, 2]


def test_a_range_with_nothing_in_it(nuscenes) -> None:
    asked = ImportRequest(("scene-0001",), FrameRange(9))
    refused(nuscenes.root, "sample_data.json: nothing was measured in scene-0001 in frames 9:$", asked)


def test_one_bad_scene_leaves_the_others(nuscenes) -> None:
    CHANGES["a chain that is cut"][0](nuscenes.rows)
    nuscenes.write()
    refused(nuscenes.root, "scene-0001 links 3 of its 6 samples")
    out = nuscenes.root.parent / "out.mcap"
    import_one(NuScenes(), nuscenes.root, out, ImportRequest(("scene-0002",)))
    assert open_log(out, FaultLog()).info.name == "out"


def test_not_json(nuscenes) -> None:
    path = nuscenes.root / "v1.0-mini/sample_data.json"
    text = path.read_text()
    path.write_text(text[: len(text) // 2])
    refused(nuscenes.root, r"sample_data.json: row \d+: .*is the file truncated\?$")
    path.write_bytes(text.encode() + b"\xff")
    refused(nuscenes.root, r"sample_data.json: isn't UTF-8 text")
    path.write_text(json.dumps(1))
    refused(nuscenes.root, r"sample_data.json: isn't a table")


@pytest.mark.parametrize("name", ["sweeps/LIDAR_TOP", "v1.0-mini/sample_data.json"])
def test_pipes_are_refused(nuscenes, name: str) -> None:
    """Nobody writes into them, so that reading would never end."""
    path = nuscenes.root / name
    path = next(path.glob("scene-0001*")) if path.is_dir() else path
    path.unlink()
    os.mkfifo(path)
    refused(nuscenes.root, rf"{path.name}: (a pipe or device, expected a file|no such table)$")


def test_poses_with_one_token_name_the_file(nuscenes) -> None:
    nuscenes.rows["ego_pose"].append(nuscenes.rows["ego_pose"][0])
    refused(nuscenes.write(), r"nuscenes/v1.0-mini/ego_pose.json: two rows have the token '[0-9a-f]{32}'$")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: b"", r"pcd.bin: is empty, is it truncated\?$"),
        (lambda data: np.frombuffer(data, "<f4").astype(">f4").tobytes(), r"pcd.bin: rings aren't numbers from 0 to"),
    ],
)
def test_sweeps_without_bytes_or_in_another_order(nuscenes, change: Callable[[bytes], bytes], message: str) -> None:
    path = next((nuscenes.root / "samples/LIDAR_TOP").glob("scene-0001*"))
    path.write_bytes(change(path.read_bytes()))
    refused(nuscenes.root, message)
