"""Sensors of a nuScenes scene."""

from collections.abc import Mapping, Sequence

import numpy as np

from fbench.datasets.nuscenes.database import DataRow
from fbench.datasets.nuscenes.tables import Tables
from fbench.replay.data import CameraModel, Kind, Mount, Rig
from fbench.replay.errors import LogError
from fbench.replay.imports.rigs import is_pinhole


def rig_of(rows: Sequence[DataRow], tables: Tables, scene: str) -> Rig:
    """Return the sensors that measured something; body coordinates are those of the ego vehicle.

    Raises:
        LogError: where a sensor's calibration or the size of its images changes within the scene, or a camera has no
            proper intrinsics.
    """
    firsts: dict[str, DataRow] = {}
    for row in rows:
        first = firsts.setdefault(row.channel, row)
        if _setting(row, tables) != _setting(first, tables):
            path = tables.folder.table("sample_data")
            raise LogError(
                f"{path}: {scene}: calibration or size of {row.channel} changes between '{first.token}' and "
                f"'{row.token}'; import the parts one by one with --frames"
            )
    kinds = _kinds(firsts, tables)
    mounts = {name: _mount(kinds[name], row, tables) for name, row in firsts.items()}
    cameras = {name: _camera(row, tables) for name, row in firsts.items() if kinds[name] == "camera"}
    return Rig(dict(sorted(mounts.items())), dict(sorted(cameras.items())))


def _kinds(rows: Mapping[str, DataRow], tables: Tables) -> dict[str, Kind]:
    return {name: tables.sensor(tables.calibration(row.calibration)).modality for name, row in rows.items()}


def _setting(row: DataRow, tables: Tables) -> tuple[object, ...]:
    """What mustn't change; equal calibrations may have several rows."""
    calibration = tables.calibration(row.calibration)
    intrinsic = tuple(calibration.camera_intrinsic)
    return (
        calibration.translation,
        calibration.rotation,
        intrinsic,
        row.width if intrinsic else 0,
        row.height if intrinsic else 0,
    )


def _mount(kind: Kind, row: DataRow, tables: Tables) -> Mount:
    calibration = tables.calibration(row.calibration)
    w, x, y, z = calibration.rotation
    return Mount(kind, np.array(calibration.translation), np.array([x, y, z, w]))


def _camera(row: DataRow, tables: Tables) -> CameraModel:
    K = np.array(tables.calibration(row.calibration).camera_intrinsic)
    if K.shape != (3, 3) or not is_pinhole(K):
        path = tables.folder.table("calibrated_sensor")
        raise LogError(f"{path}: row with token '{row.calibration}': camera_intrinsic isn't that of {row.channel}")
    if not (row.width and row.height):
        path = tables.folder.table("sample_data")
        raise LogError(f"{path}: row with token '{row.token}': an image of {row.channel} without width and height")
    return CameraModel(K, (row.width, row.height))
