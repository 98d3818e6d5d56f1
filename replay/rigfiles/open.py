"""Opening a file with calibration, whatever form it is in."""

from pathlib import Path

from fbench.replay.errors import ConfigError
from fbench.replay.rig_patch import RigPatch
from fbench.replay.rigfiles.camera_info import read_camera_info
from fbench.replay.rigfiles.kalibr import read_kalibr
from fbench.replay.rigfiles.own import read_own
from fbench.replay.rigfiles.urdf import read_urdf
from fbench.replay.rigfiles.values import MALFORMED
from fbench.replay.yaml_file import YamlFileError, parse_yaml

MAX_TEXT = 1024 * 1024
"""Bytes of a TOML or YAML file; a rig of a hundred sensors has a tenth of it."""
MAX_XML = 16 * 1024 * 1024
"""Bytes of a URDF file."""
_FORMS = "fbench's TOML ([sensors.NAME] ...), URDF, a Kalibr camchain, or camera_info YAML of ROS"
_IMU_KEYS = ("imu", "accelerometer_noise_density", "gyroscope_noise_density")


def open_rig_file(path: Path) -> RigPatch:
    """Read calibration; the form is told by the content: our TOML, URDF, Kalibr camchain, or ROS camera_info YAML.

    Raises:
        ConfigError: naming the file, and the key that is wrong.
    """
    content = _content(path)
    start = content.removeprefix(b"\xef\xbb\xbf").lstrip()
    if path.suffix.lower() == ".xacro" or start.startswith(b"<"):
        patch = read_urdf(path, content)
    elif len(content) > MAX_TEXT:
        raise _too_large(path, MAX_TEXT)
    elif _is_toml(path, start):
        patch = read_own(path, content)
    else:
        patch = _yaml(path, content)
    return RigPatch(
        patch.edges, patch.cameras, patch.topics,
        {name: str(path) for name in [*patch.edges, *patch.cameras, *patch.topics, *patch.moving]}, patch.moving,
    )  # fmt: skip


def _content(path: Path) -> bytes:
    if path.exists() and not path.is_file():  # a FIFO would block, a device could go on for ever
        raise ConfigError(f"{path}: not a regular file; name the file with the calibration")
    try:
        with path.open("rb") as file:
            content = file.read(MAX_XML + 1)
    except OSError as error:
        raise ConfigError(f"{path}: can't be read ({error.strerror})") from error
    if len(content) > MAX_XML:
        raise _too_large(path, MAX_XML)
    return content


def _too_large(path: Path, limit: int) -> ConfigError:
    return ConfigError(f"{path}: has more than {limit} bytes, too large for a calibration", MALFORMED)


def _is_toml(path: Path, start: bytes) -> bool:
    """TOML begins with a table or `key =`, which none of the YAML forms does."""
    if path.suffix.lower() == ".toml":
        return True
    lines = (line.strip() for line in start.splitlines())
    first = next((line for line in lines if line and not line.startswith(b"#")), b"")
    return first.startswith(b"[") or b"=" in first.partition(b":")[0]


def _yaml(path: Path, content: bytes) -> RigPatch:
    if content.lstrip().startswith(b"%YAML:"):
        raise ConfigError(f"{path}: an OpenCV FileStorage isn't read; expected {_FORMS}", MALFORMED)
    try:
        tree = parse_yaml(content)
    except YamlFileError as error:
        raise ConfigError(f"{path}: {error}", MALFORMED) from error
    keys = [key for key in tree if isinstance(key, str)] if isinstance(tree, dict) else []
    if isinstance(tree, dict) and ("camera_matrix" in keys or "image_width" in keys):
        return read_camera_info(path, tree)
    if isinstance(tree, dict) and any(_is_numbered(key, "cam") for key in keys):
        return read_kalibr(path, tree)
    if any(key in _IMU_KEYS or _is_numbered(key, "imu") for key in keys):
        raise ConfigError(f"{path}: is about an IMU, and holds no camera; name the camchain of Kalibr", MALFORMED)
    raise ConfigError(f"{path}: no calibration that is known; expected {_FORMS}", MALFORMED)


def _is_numbered(key: str, name: str) -> bool:
    digits = key.removeprefix(name)
    return key.startswith(name) and digits.isascii() and digits.isdecimal()
