"""A Python plug-in as a program: `python -m fbench.pipelines.external.host DEVICE NAME [SETTING ...]`.

`Isolated` runs it. It speaks the protocol of `exec` over pipes that the plug-in doesn't have as stdin and stdout.
Whatever the plug-in raises is an error in the response, made into one line here.
"""

import ctypes
import json
import os
import resource
import signal
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, BinaryIO

import numpy as np

from fbench.pipelines.external import fbench_exec_pb2 as schema
from fbench.pipelines.external.messages import COLUMNS, KINDS, VERSION, WIRE
from fbench.pipelines.external.session import LENGTH
from fbench.replay.contracts.devices import current_execution, use_device
from fbench.replay.contracts.errors import FbenchError, MissingPackageError, one_line
from fbench.replay.contracts.plugins import make_pipeline
from fbench.replay.contracts.protocols import Closes, NeedsSensors, TellsIdentity, Tracks, UsesLog
from fbench.replay.data.boxes import Boxes, Boxes3D
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.engine.cleaning import OutputCheck

_PDEATHSIG = 1  # Of prctl: the signal that comes when the parent ends
_MEMORY_SHARE = 0.9  # Of the machine's memory, which a plug-in may take


class Host:
    """Answers requests with one pipeline."""

    def __init__(self, name: str, settings: list[str]) -> None:
        self._name, self._settings = name, settings
        self._pipeline: Any = None
        self._check: OutputCheck | None = None
        self._answers: Mapping[str, Callable[[], object]] = {
            "made": self._make, "identity": self._identify, "required_sensors": self._require_sensors,
            "is_tracker": self._is_tracker, "close": self._close, "providers": lambda: current_execution().providers,
        }  # fmt: skip

    def respond(self, request: schema.Request) -> schema.Response:
        """Do what is requested; whatever is raised meanwhile is the response."""
        response, limit = schema.Response(sequence=request.sequence), sys.getrecursionlimit()
        try:
            match request.WhichOneof("kind"):
                case "hello":
                    self._start(request.hello)
                    response.ready.version = VERSION
                case "reset":
                    self._made.reset(request.reset.reason)
                    response.done.SetInParent()
                case "frame":
                    output = self._made.step(read_frame(request.frame))
                    write_output(self._check(output) if self._check else output, response.output)
                case _:
                    response.answer.json = json.dumps(self._answers[request.question.name]())
        except BaseException as error:  # noqa: BLE001 - a plug-in may raise anything, and nobody interrupts this process
            sys.setrecursionlimit(limit)
            response.ClearField("output")
            text = one_line(error)
            is_in_loop = request.WhichOneof("kind") in ("reset", "frame")  # where it is the failure of a frame
            if isinstance(error, MissingPackageError) or (isinstance(error, FbenchError) and not is_in_loop):
                text, response.error_type, response.error_code = str(error), type(error).__name__, error.code
            response.error = text.encode(errors="replace").decode()
        finally:
            sys.setrecursionlimit(limit)  # a plug-in may have changed it
        return response

    @property
    def _made(self) -> Any:
        if self._pipeline is None:  # after the process was started again
            self._make()
        return self._pipeline

    def _make(self) -> dict[str, object]:
        self._pipeline, parameters = make_pipeline(self._name, self._settings)
        return {"parameters": parameters, "uses_log": isinstance(self._pipeline, UsesLog)}

    def _start(self, hello: schema.Hello) -> None:
        rig = read_rig(hello)
        self._made.start(rig, LogInfo(hello.log_name, hello.log_id, dict(sorted(hello.metadata.items()))))
        self._check = self._check or OutputCheck(rig)

    def _identify(self) -> dict[str, object]:
        identity = dict(self._made.identity()) if isinstance(self._made, TellsIdentity) else {}
        json.dumps(identity, allow_nan=False)
        return identity

    def _require_sensors(self) -> list[str] | None:
        needed = self._made.required_sensors() if isinstance(self._made, NeedsSensors) else None
        return None if needed is None else sorted(needed)

    def _is_tracker(self) -> bool | None:
        return bool(self._made.is_tracker) if isinstance(self._made, Tracks) else None

    def _close(self) -> None:
        if isinstance(self._pipeline, Closes):
            self._pipeline.close()


def read_rig(hello: schema.Hello) -> Rig:
    """Return the rig that a `Hello` tells of."""
    kinds = {value: kind for kind, value in KINDS.items()}
    mounts, cameras, bare = dict[str, Mount](), dict[str, CameraModel](), set[str]()
    for sensor in hello.sensors:
        translation_m = np.array(sensor.translation_m)
        if np.isnan(translation_m).any():
            bare.add(sensor.name)
        else:
            mounts[sensor.name] = Mount(kinds[sensor.kind], translation_m, np.array(sensor.rotation_xyzw))
        if sensor.HasField("camera"):
            c = sensor.camera
            size_wh, distortion = (c.width_px, c.height_px), np.array(c.distortion, np.float64)
            K = np.array(c.k).reshape(3, 3)
            cameras[sensor.name] = CameraModel(K, size_wh, c.distortion_model, distortion)
    return Rig(mounts, cameras, frozenset(bare))


def read_frame(frame: schema.Frame) -> Frame:
    """Return the frame that a request tells of; its arrays are views of the request."""
    messages = {message.sensor: _read_message(message) for message in frame.messages}
    number = frame.frame_number if frame.HasField("frame_number") else None
    missing = dict(sorted(frame.missing.items()))
    return Frame(frame.index, frame.stamp_ns, frame.segment, messages, missing, number)


def _read_message(message: schema.Message) -> Message:
    head = message.sensor, message.stamp_ns, message.log_ns
    number = message.frame_number if message.HasField("frame_number") else None
    match message.WhichOneof("content"):
        case "image":
            image = message.image
            return Image(*head, image.data, image.encoding, (image.width_px, image.height_px), number)
        case "pose":
            place = np.array(message.pose.translation_m), np.array(message.pose.rotation_xyzw)
            return Pose(*head, *place, frame_number=number)
        case "points":
            return PointCloud(*head, **_read_columns(message.points), frame_number=number)
        case _:
            return RadarScan(*head, **_read_columns(message.radar), frame_number=number)


def _read_columns(points: schema.PointCloud | schema.RadarScan) -> dict[str, Any]:
    columns = {"xyz": np.zeros((0, 3), np.float32)}
    for field, data in points.ListFields():
        array = np.frombuffer(data, WIRE.get(field.name, "<f4"))
        columns[field.name] = array.reshape(-1, 3) if field.name == "xyz" else array
    return columns


def write_output(output: Output, to: schema.Output) -> None:
    """Put an output that was checked into a response."""
    found = to.in_3d if isinstance(output.detections, Boxes3D) else to.in_2d
    found.SetInParent()
    for name in ("detections", "tracks"):
        boxes: Boxes | None = getattr(output, name)
        if boxes is None:
            continue
        message = getattr(found, name)
        message.SetInParent()
        for column, array in boxes.arrays().items():
            getattr(message, column).extend(array.ravel().tolist())
        if not len(boxes):
            getattr(message, COLUMNS).extend(boxes.arrays())
    for stage, duration_ns in output.stage_ns.items():
        to.stages.add(name=stage, duration_ns=int(duration_ns))
    for sensor, why in output.missing.items():
        to.missing[sensor] = why
    for fault in output.faults:
        to.faults.add(code=fault.code, where=fault.where)
    to.log_clock = output.clock == "log"
    for stage, digest in output.digests.items():
        to.digests.add(stage=stage, digest=digest)


def main() -> None:
    """Answer requests until stdin is closed."""
    requests, responses = _take_pipes()
    _be_expendable()
    host = Host(sys.argv[2], sys.argv[3:])
    with use_device("cuda" if sys.argv[1] == "cuda" else "cpu"):
        while (data := _read(requests)) is not None:
            response = host.respond(schema.Request.FromString(data)).SerializeToString()
            responses.write(LENGTH.pack(len(response)) + response)
            responses.flush()
    sys.stderr.flush()
    os._exit(0)  # whatever threads and exit handlers the plug-in has


def _take_pipes() -> tuple[BinaryIO, BinaryIO]:
    """Return what was stdin and stdout; the plug-in gets an empty stdin, and what it prints goes to stderr."""
    requests, responses = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    return requests, responses


def _be_expendable() -> None:
    """End with fbench however that ends, and be the first to fail where memory is short, instead of fbench."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PDEATHSIG, signal.SIGKILL)
    with suppress(OSError), open("/proc/self/oom_score_adj", "w", encoding="ascii") as file:
        file.write("1000")
    with suppress(OSError, ValueError):
        most = int(_MEMORY_SHARE * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
        _, hard = resource.getrlimit(resource.RLIMIT_DATA)
        resource.setrlimit(resource.RLIMIT_DATA, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _read(requests: BinaryIO) -> bytes | None:
    head = requests.read(LENGTH.size)
    if len(head) < LENGTH.size:
        return None
    (num,) = LENGTH.unpack(head)
    data = requests.read(num)
    return data if len(data) == num else None


if __name__ == "__main__":
    main()
