"""Programs that misbehave on demand, for the tests of `exec`."""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fbench.pipelines.external.pipeline import Exec, ExecParams
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import PointCloud
from fbench.replay.data.rig import LogInfo, Mount, Rig

ROOT = Path(__file__).resolve().parents[3]
CLIENT = ROOT / "examples" / "exec" / "python"
RIG = Rig({"lidar": Mount("lidar", np.array([1.0, 0, 2]), np.array([0, 0, 0, 1.0]))}, {})
INFO = LogInfo("drive", "drive-1", {"place": "here"})

# Talks by itself, so that it can break every rule; ACTIONS runs where a frame's index is a key of it.
_WICKED = f"""
import os, signal, struct, sys, time
sys.path[:0] = [{str(CLIENT)!r}, {str(ROOT / "pipelines" / "external")!r}]
import fbench_exec_pb2 as schema

def read(n):
    data = b""
    while len(data) < n:
        part = os.read(0, n - len(data))
        if not part:
            sys.exit(0)
        data += part
    return data

def frame_of(data):
    return struct.pack("<I", len(data)) + data

def write(data):
    while data:
        data = data[os.write(1, data):]

def answer(request, **kind):
    return frame_of(schema.Response(sequence=request.sequence, **kind).SerializeToString())

def box(x, **more):
    fields = dict(center_m=[x, 0, 0], size_lwh_m=[4, 2, 1], yaw_rad=[0], score=[1], label=["car"])
    return schema.Boxes3D(**{{**fields, **more}})

def output(x, **more):
    return schema.Output(in_3d=schema.Results3D(detections=box(x, **more)))

def staged(*stages):
    return schema.Output(in_3d=schema.Results3D(), stages=[schema.Stage(**stage) for stage in stages])

VERSION = 1
resets = 0
ACTIONS = {{}}
exec(sys.argv[1])
while True:
    (num,) = struct.unpack("<I", read(4))
    request = schema.Request.FromString(read(num))
    kind = request.WhichOneof("kind")
    if kind == "hello":
        print("hello", flush=True, file=sys.stderr)
        write(answer(request, ready=schema.Ready(version=VERSION, name="wicked")))
    elif kind == "reset":
        resets += 1
        write(answer(request, done=schema.Done()))
    else:
        index = request.frame.index
        data = None
        if index in ACTIONS:
            data = ACTIONS[index](request)
        write(answer(request, output=output(100 * resets + index)) if data is None else data)
"""


def wicked(folder: Path, code: str, **params: float) -> Exec:
    """A program that runs `code` first; without it, it finds a car at x = 100 * resets + frame."""
    path = folder / "wicked.py"
    path.write_text(_WICKED)
    quoted = "'" + code.replace("'", "'\"'\"'") + "'"
    return Exec(ExecParams(f"{sys.executable} {path} {quoted}", **{"frame_timeout_s": 30.0, **params}))


def frame(index: int, num: int = 4, sensors: Sequence[str] = ("lidar",)) -> Frame:
    stamp = 100_000_000 * index
    xyz = np.arange(3 * num, dtype=np.float32).reshape(num, 3)
    return Frame(index, stamp, 0, {s: PointCloud(s, stamp, stamp + 1, xyz) for s in sensors})
