"""Rigs in `log.json`: numbers are written so that float64 is read back exactly."""

from typing import Annotated, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from fbench.replay.data import CameraModel, Kind, Mount, Rig
from fbench.replay.errors import DataError, LogError

Natural = Annotated[int, Field(ge=0, lt=2**64)]


class Strict(BaseModel):
    """Nothing unknown, no conversions, no NaN."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class MountEntry(Strict):
    """A sensor's pose on the body."""

    kind: Kind
    translation_m: list[float]
    rotation_xyzw: list[float]


class CameraEntry(Strict):
    """Intrinsics of a camera."""

    K: list[list[float]]
    size_wh: Annotated[list[Annotated[int, Field(gt=0)]], Field(min_length=2, max_length=2)]
    distortion_model: str = ""
    distortion: list[float] = Field(default_factory=list)


class RigEntry(Strict):
    """A rig, and from when it holds."""

    log_ns: Natural = 0
    stamp_ns: Natural | None = None
    """Stamp of the messages that told it, where there were any."""
    mounts: dict[str, MountEntry] = Field(default_factory=dict)
    cameras: dict[str, CameraEntry] = Field(default_factory=dict)

    @classmethod
    def of(cls, log_ns: int, rig: Rig, stamp_ns: int | None = None) -> Self:
        """Return a rig in the form of `log.json`."""
        mounts = {
            name: MountEntry(
                kind=m.kind, translation_m=m.translation_m.tolist(), rotation_xyzw=m.rotation_xyzw.tolist()
            )
            for name, m in sorted(rig.mounts.items())
        }
        cameras = {
            name: CameraEntry(
                K=c.K.tolist(), size_wh=list(c.size_wh), distortion_model=c.distortion_model,
                distortion=c.distortion.tolist(),
            )
            for name, c in sorted(rig.cameras.items())
        }  # fmt: skip
        return cls(log_ns=log_ns, stamp_ns=stamp_ns, mounts=mounts, cameras=cameras)

    def rig(self) -> Rig:
        """Return the rig as data.

        Raises:
            LogError: naming the sensor whose pose isn't one, or the camera that isn't calibrated.
        """
        mounts = {name: _mount(name, entry) for name, entry in sorted(self.mounts.items())}
        cameras = {name: _camera(name, entry) for name, entry in sorted(self.cameras.items())}
        bare = [name for name, mount in mounts.items() if mount.kind == "camera" and name not in cameras]
        if bare:
            raise LogError(f"camera '{bare[0]}' has no calibration (key 'cameras' of its rig)", "CAL001")
        return Rig(mounts, cameras)


def _mount(name: str, entry: MountEntry) -> Mount:
    try:
        mount = Mount(entry.kind, np.array(entry.translation_m, "f8"), np.array(entry.rotation_xyzw, "f8"))
    except DataError as error:
        raise LogError(f"sensor '{name}': {error}", "CAL001") from error
    if not np.any(mount.rotation_xyzw):
        raise LogError(f"sensor '{name}' has no valid pose (rotation {entry.rotation_xyzw})", "CAL001")
    return mount


def _camera(name: str, entry: CameraEntry) -> CameraModel:
    try:
        K, distortion = np.array(entry.K, "f8"), np.array(entry.distortion, "f8")
        camera = CameraModel(K, (entry.size_wh[0], entry.size_wh[1]), entry.distortion_model, distortion)
    except (DataError, ValueError) as error:
        raise LogError(f"camera '{name}': {error}", "CAL001") from error
    if not (camera.K[0, 0] > 0 and camera.K[1, 1] > 0):
        raise LogError(f"camera '{name}' has no valid focal length", "CAL001")
    return camera
