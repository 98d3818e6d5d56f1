"""Writing calibration in our own form, so that it can be read back."""

import json
from collections.abc import Iterator

from fbench.replay.data.arrays import Array
from fbench.replay.data.rig import CameraModel, Mount, Rig


def rig_toml(rig: Rig) -> str:
    """Return a rig as the TOML that `open_rig_file` reads; every number is read back bit for bit."""
    blocks = [_sensor(name, mount) for name, mount in sorted(rig.mounts.items())]
    blocks += [_camera(name, camera) for name, camera in sorted(rig.cameras.items())]
    return "\n".join("".join(f"{line}\n" for line in block) for block in blocks)


def _sensor(name: str, mount: Mount) -> Iterator[str]:
    yield f"[sensors.{_text(name)}]  # {mount.kind}, in body coordinates: x forward, y left, z up"
    yield f"translation_m = {_list(mount.translation_m)}"
    yield f"rotation_xyzw = {_list(mount.rotation_xyzw)}"


def _camera(name: str, camera: CameraModel) -> Iterator[str]:
    yield f"[cameras.{_text(name)}]"
    yield f"K = [{', '.join(_list(row) for row in camera.K)}]"
    yield f"size_wh = [{camera.size_wh[0]}, {camera.size_wh[1]}]"
    if camera.distortion_model or camera.distortion.size:
        yield f"distortion_model = {_text(camera.distortion_model)}"
        yield f"distortion = {_list(camera.distortion)}"


def _list(values: Array) -> str:
    return f"[{', '.join(repr(value) for value in values.tolist())}]"


def _text(text: str) -> str:
    """A basic string of TOML, which is one of JSON but for DEL."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
