"""Everything that a Python program needs to be run by `fbench replay -p exec:...`: numpy, protobuf and this file.

Where fbench isn't installed, generate `fbench_exec_pb2.py` beside this file, for the protobuf that you have:
`protoc --python_out=. fbench_exec.proto`.
"""

import os
import struct
import sys
from typing import Any, BinaryIO, Protocol

import numpy as np

try:
    import fbench_exec_pb2 as schema
except ImportError:
    from fbench.pipelines.external import fbench_exec_pb2 as schema

VERSION = 1
_LENGTH = struct.Struct("<I")
_FIELDS: dict[str, tuple[str, int]] = {
    "xyz": ("<f4", 3), "intensity": ("<f4", 1), "ring": ("<u2", 1), "offset_ns": ("<i4", 1),
    "radial_velocity_mps": ("<f4", 1), "rcs_dbsm": ("<f4", 1), "range_m": ("<f4", 1), "azimuth_rad": ("<f4", 1),
    "altitude_rad": ("<f4", 1),
}  # fmt: skip


class Stack(Protocol):
    """What you write."""

    name: str

    def start(self, hello: Any) -> None:
        """A log begins, or its calibration changes: `schema.Hello`. Raise an exception if you can't work with it."""
        ...

    def reset(self, reason: str) -> None:
        """Forget all tracks."""
        ...

    def step(self, frame: Any) -> Any:
        """Return a `schema.Output` for a `schema.Frame`. An exception fails this frame, and the next one comes."""
        ...


def columns(message: Any) -> dict[str, np.ndarray]:
    """Arrays of a `PointCloud` or `RadarScan`, by field name, as views: (N, 3) for `xyz`, else (N,)."""
    found = {}
    for field, _ in message.ListFields():
        dtype, width = _FIELDS[field.name]
        array = np.frombuffer(getattr(message, field.name), dtype)
        found[field.name] = array.reshape(-1, width) if width > 1 else array
    return {"xyz": np.zeros((0, 3), "<f4"), **found}


def body_T_sensor(sensor: Any) -> np.ndarray:
    """Matrix (4, 4) that moves points from the sensor's to body coordinates; quaternion x, y, z, w."""
    x, y, z, w = sensor.rotation_xyzw
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = sensor.translation_m
    return matrix


def run(stack: Stack) -> None:
    """Answer fbench until it closes stdin. What is printed from now on goes to stderr."""
    requests, responses = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    sys.stdout.flush()
    os.dup2(2, 1)
    while (request := _read(requests)) is not None:
        data = _answer(stack, request).SerializeToString()
        responses.write(_LENGTH.pack(len(data)) + data)
        responses.flush()


def _read(stream: BinaryIO) -> Any:
    head = stream.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        return None
    (num,) = _LENGTH.unpack(head)
    data = stream.read(num)
    return schema.Request.FromString(data) if len(data) == num else None


def _answer(stack: Stack, request: Any) -> Any:
    response = schema.Response(sequence=request.sequence)
    kind = request.WhichOneof("kind")
    try:
        if kind == "hello":
            if request.hello.version != VERSION:
                raise ValueError(f"this program speaks version {VERSION} of the protocol")
            stack.start(request.hello)
            response.ready.version, response.ready.name = VERSION, stack.name
        elif kind == "reset":
            stack.reset(request.reset.reason)
            response.done.SetInParent()
        elif kind == "frame":
            response.output.CopyFrom(stack.step(request.frame))
        else:
            raise ValueError("this request isn't known")
    except Exception as error:  # noqa: BLE001 - whatever it is, fbench should know, and the next frame comes
        response.error = f"{type(error).__name__}: {error}"
    return response
