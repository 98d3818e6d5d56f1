"""Weights and programs: ONNX files with edited fields, and answers of a program of `exec`."""

import struct
from functools import cache
from pathlib import Path

import numpy as np
from tests.hostile.damage import Random, damage, edit_number, edit_proto
from tests.hostile.target import Case, Found
from tests.pipelines.conftest import encode_model
from tests.pipelines.external.programs import INFO, RIG

from fbench.pipelines.external import fbench_exec_pb2 as schema
from fbench.pipelines.external.pipeline import Exec, ExecParams
from fbench.pipelines.sensors.camera.model import Model
from fbench.replay.contracts.errors import FbenchError
from fbench.replay.data.frames import Frame

LENGTH = struct.Struct("<I")


@cache
def onnx() -> bytes:
    """A small detector."""
    return encode_model(
        {
            "labels": np.array([[2, 0, 7]], np.int64),
            "boxes": np.array([[[10, 20, 50, 60], [70, 20, 80, 60], [0, 0, 5, 5]]], np.float32),
            "scores": np.array([[0.9, 0.8, 0.1]], np.float32),
        },
        {"images": ("float32", (1, 3, 32, 32)), "orig_target_sizes": ("int64", (1, 2))},
        {"names": "{0: 'person', 2: 'car'}"},
    )


def make_onnx(random: Random) -> Case:
    """Change fields, now and then bytes."""
    how = [edit_proto, edit_proto, edit_proto, damage][int(random.integers(4))]
    return Case({"model.onnx": how(onnx(), random)})


def use_onnx(folder: Path) -> Found:
    """Load the model, and run it on a blank image."""
    model = Model(folder / "model.onnx", 1, None)
    for batch in model.batches([np.zeros((40, 60, 3), np.uint8)]):
        model.run(batch, 0.1)
    return Found()


@cache
def answers() -> tuple[bytes, ...]:
    """What a program says to greeting, reset and two frames."""
    boxes = schema.Boxes3D(
        center_m=[1, 2, 3, 4, 5, 6], size_lwh_m=[4, 2, 1] * 2, yaw_rad=[0, 1], score=[1, 0.5], label=["car", "bus"]
    )
    tracks = schema.Boxes3D(center_m=[1, 2, 3], size_lwh_m=[4, 2, 1], yaw_rad=[0], track_id=[7])
    output = schema.Output(
        in_3d=schema.Results3D(detections=boxes, tracks=tracks), missing={"lidar": "late"},
        stages=[schema.Stage(name="detect", duration_ns=5)],
    )  # fmt: skip
    kinds = [
        {"ready": schema.Ready(version=1, name="p")},
        {"done": schema.Done()},
        {"output": output},
        {"output": output},
    ]
    return tuple(schema.Response(sequence=i + 1, **kind).SerializeToString() for i, kind in enumerate(kinds))


def make_exec(random: Random) -> Case:
    """Change fields of one answer, or its length, or the bytes of all."""
    said = list(answers())
    i = int(random.integers(len(said)))
    if random.random() < 0.7:
        said[i] = edit_proto(said[i], random)
    stream = b"".join(LENGTH.pack(len(answer)) + answer for answer in said)
    if random.random() < 0.3:
        stream = [damage, edit_number][int(random.integers(2))](stream, random)
    return Case({"answers": stream})


def use_exec(folder: Path) -> Found:
    """Replay two frames through a program that says this: each is answered, or fails in one line."""
    params = ExecParams(
        command=f"cat {folder / 'answers'}", frame_timeout_s=0.2, start_timeout_s=0.5, close_timeout_s=0.2
    )
    pipeline, refused = Exec(params), None
    try:
        pipeline.start(RIG, INFO)
        pipeline.reset("start")
        for index in range(2):
            try:
                pipeline.step(Frame(index, 10**9 + index, 0, {}, {}))
            except FbenchError as error:
                refused = error
    finally:
        pipeline.close()
    if refused is not None:
        raise refused
    return Found()
