"""All kinds of untrusted input that are fuzzed, by name."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from tests.hostile import documents, mcap_logs, messages, programs, recordings, whole
from tests.hostile.damage import Random
from tests.hostile.target import Case, Found, Target

Make = Callable[[Random], Case]


def _log(what: str, make: Make, name: str, is_forged: bool = False) -> Target:
    def use(folder: Path) -> Found:
        return mcap_logs.read(folder / name, is_forged)

    return Target(what, make, use)


def _mcap(what: str, kind: str) -> Target:
    return _log(what, partial(mcap_logs.damaged, kind), mcap_logs.NAME)


TARGETS: Mapping[str, Target] = {
    "mcap": _mcap("MCAP in chunks, damaged", "mcap"),
    "mcap-no-summary": _mcap("MCAP in chunks without a summary, damaged", "mcap-no-summary"),
    "mcap-unchunked": _mcap("MCAP without chunks, damaged", "mcap-unchunked"),
    "mcap-no-checksums": _mcap("MCAP without checksums, damaged", "mcap-no-checksums"),
    "mcap-forged": _log("MCAP, records and fields edited, checksums right", mcap_logs.forged, mcap_logs.NAME, True),
    "parquet": _log("Parquet log, damaged", recordings.damage_parquet, recordings.FOLDER),
    "parquet-edited": _log(
        "Parquet log without checksums, text, footers and columns edited",
        recordings.edit_parquet,
        recordings.FOLDER,
        True,
    ),
    "bag1": _log("ROS 1 bag, damaged and numbers edited", recordings.damage_bag1, recordings.BAG1),
    "sqlite": _log("rosbag2 in SQLite, damaged and numbers edited", recordings.damage_sqlite, recordings.FOLDER),
    "sqlite-edited": _log("rosbag2 in SQLite, cells edited", recordings.edit_sqlite, recordings.FOLDER, True),
    "rosbag2": _log(
        "rosbag2 in MCAP, description edited, file damaged", recordings.edit_recording, recordings.FOLDER, True
    ),
    "cdr": Target("ROS 2 message, payload and definition edited", partial(messages.make_ros, "cdr"), messages.use_ros),
    "ros1": Target(
        "ROS 1 message, payload and definition edited", partial(messages.make_ros, "ros1"), messages.use_ros
    ),
    "idl": Target("ROS 2 message, definition in IDL edited", messages.make_idl, messages.use_ros),
    "json": Target("Foxglove message in JSON, edited", messages.make_json, messages.use_json),
    "toml": Target("`fbench.toml`, edited", documents.make_config, documents.use_config),
    "rig": Target("calibration in TOML, URDF and YAML, edited", documents.make_rig, documents.use_rig),
    "boxes": Target("boxes in CSV, JSON and text files, edited", documents.make_boxes, documents.use_boxes),
    "box-table": Target("boxes in a Parquet table, numbers edited", documents.make_table, documents.use_boxes),
    "onnx": Target("ONNX weights, fields edited", programs.make_onnx, programs.use_onnx),
    "exec": Target("answers of a program of `exec`, fields and lengths edited", programs.make_exec, programs.use_exec),
    **whole.TARGETS,
}
