"""In whose coordinates KITTI's 3D boxes are written."""

from fbench.replay.arrays import Float64
from fbench.replay.boxfiles.kitti_rows import CAMERA_T_LEVEL
from fbench.replay.data import Rig
from fbench.replay.errors import ConfigError
from fbench.replay.export.sequence import BoxSequence
from fbench.replay.log_keys import CAMERA0
from fbench.replay.names import did_you_mean

BODY = "body"
"""The body's axes, turned: where KITTI's rectified camera 0 is the body, as in its logs."""


def coordinate_frame(sequence: BoxSequence, wished: str, camera: str) -> str:
    """Return `body` or the name of a camera: as asked for, as the log says, else that of the image.

    Raises:
        ConfigError: where it is none of these.
    """
    known = [BODY, *sequence.rig.sensors("camera")]
    name = wished or sequence.metadata.get(CAMERA0, camera)
    if name not in known and any(frame.boxes3d is not None for frame in sequence.frames):
        raise ConfigError(f"{sequence.where}: --frame {name}: neither 'body' nor a camera{did_you_mean(name, known)}")
    return name


def body_T_level(name: str, rig: Rig) -> Float64 | None:
    """Matrix (4, 4) from coordinates at a camera, with x forward, y left, z up, to the body; `None`: they are the same.

    There boxes stand upright, and the camera's own coordinates are these with the axes turned.
    """
    return None if name == BODY or name not in rig.mounts else rig.body_T_sensor(name) @ CAMERA_T_LEVEL
