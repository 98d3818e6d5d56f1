"""Codec of `foxglove.SceneUpdate` as other programs write it."""

import numpy as np
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from fbench.replay.data import Truth
from fbench.replay.errors import DataError, DecodeError
from fbench.replay.logs.codec import Origin
from fbench.replay.logs.foxglove.proto import nanoseconds, parse
from fbench.replay.logs.scenes import scene_boxes
from fbench.replay.logs.truth_part import TruthPart, part_of

_MAX_BYTES = 8 * 2**20
"""As of messages of ROS: an entity that says nothing takes two bytes, and a hundred times that in memory."""


def read_scene(data: memoryview, origin: Origin) -> TruthPart:
    """Decode the boxes of a scene, at the newest stamp of its entities; deletions give nothing but a stamp.

    Raises:
        DecodeError: where the message is damaged or too large, or a box isn't finite.
    """
    if len(data) > _MAX_BYTES:
        raise DecodeError(f"scene of {len(data)} bytes, more than {_MAX_BYTES}")
    scene = parse(SceneUpdate, data)
    try:
        with np.errstate(all="ignore"):  # values that aren't finite, or out of range, are dealt with where they matter
            boxes, frames = scene_boxes(scene.entities)
    except (ValueError, DataError) as error:
        raise DecodeError(f"not a usable scene ({error})") from error
    stamp_ns = max(map(_stamp_ns, scene.entities or scene.deletions), default=0)
    truth = Truth(stamp_ns or origin.publish_ns, origin.log_ns, boxes, frame_number=origin.frame_number)
    return part_of(truth, frames)


def _stamp_ns(part: SceneEntity | SceneEntityDeletion) -> int:
    return nanoseconds(part.timestamp)
