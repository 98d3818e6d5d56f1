"""Videos made by PyAV, logs of them written by other programs, and decoding of a whole video in order as the oracle."""

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from google.protobuf.timestamp_pb2 import Timestamp
from mcap_protobuf.writer import Writer
from tests.replay.logs.test_foreign import edge, packed

MS = 1_000_000
START = 1_700_000_000_000 * MS
SIZE = (96, 64)
XYZ = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
ENCODERS = {
    "h264": ("libx264", {"tune": "zerolatency"}),
    "h265": ("libx265", {"tune": "zerolatency", "x265-params": "log-level=none"}),
    "vp9": ("libvpx-vp9", {"deadline": "realtime", "lag-in-frames": "0", "crf": "30", "b": "0"}),
}
DECODERS = {"h264": "h264", "h265": "hevc", "vp9": "vp9", "av1": "libdav1d"}


def pictures(num, size_wh=SIZE):
    """Smooth colors that move, so that each picture needs the one before it; (H, W, 3) BGR."""
    width, height = size_wh
    noise = np.random.Generator(np.random.Philox(5)).integers(0, 255, (height, width + 3 * num, 3)).astype(np.float32)
    smooth = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 4), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    return [np.ascontiguousarray(smooth[:, 3 * i : 3 * i + width]) for i in range(num)]


def encode(codec="h264", num=12, key_every=6, size_wh=SIZE, form="yuv420p", tags=(), p_only=False, **options):
    """Packets of a video, one a picture unless options ask for B-frames; `tags` are attributes of pictures."""
    name, given = ENCODERS[codec]
    context = av.CodecContext.create(name, "w")
    context.width, context.height = size_wh
    context.pix_fmt, context.time_base, context.framerate, context.gop_size = form, Fraction(1, 10), 10, key_every
    context.thread_count = 1
    for tag, value in tags:
        setattr(context, tag, value)
    context.options = {**given, **options}
    found = []
    for i, picture in enumerate(pictures(num, size_wh)):
        frame = av.VideoFrame.from_ndarray(picture, format="bgr24").reformat(format=form)
        frame.pts = i
        if p_only and i:
            frame.pict_type = 2
        found += context.encode(frame)
    return [bytes(packet) for packet in [*found, *context.encode(None)]]


def decode_all(codec, packets):
    """All pictures of a video, by PyAV, in order."""
    return _decode(codec, packets, is_end=True)


def decode_first(codec, packets):
    """Pictures that PyAV gives before it gets more."""
    return _decode(codec, packets, is_end=False)


def _decode(codec, packets, is_end):
    context = av.CodecContext.create(DECODERS[codec], "r")
    context.thread_count = 1
    frames = [frame for packet in packets for frame in context.decode(av.Packet(packet))]
    return [*frames, *(context.decode(None) if is_end else [])]


def planes(frame):
    """Planes (H, W) of a picture, in float; each sample of color is repeated for its block."""
    dtype = np.uint16 if frame.format.name.endswith("le") else np.uint8
    found = []
    for plane in frame.planes:
        rows = np.frombuffer(plane, dtype).reshape(plane.height, -1)[:, : plane.width].astype(np.float64)
        down, across = -(-frame.height // plane.height), -(-frame.width // plane.width)
        found.append(rows.repeat(down, axis=0).repeat(across, axis=1)[: frame.height, : frame.width])
    return found


def to_bgr(frame, red=0.299, blue=0.114, depth=8, full=False):
    """ITU-T H.273 in float: E'Y and E'PB, E'PR from samples, then R, G and B."""
    y, cb, cr = planes(frame)
    top = 2**depth - 1
    scale = 2 ** (depth - 8)
    light = y / top if full else (y - 16 * scale) / (219 * scale)
    pb, pr = ((c - 128 * scale) / (top if full else 224 * scale) for c in (cb, cr))
    r, b = light + 2 * (1 - red) * pr, light + 2 * (1 - blue) * pb
    g = (light - red * r - blue * b) / (1 - red - blue)
    return np.clip(255 * np.stack([b, g, r], axis=2), 0, 255)


def require_same(found, exact):
    """Pixels are exact values, rounded."""
    assert found.dtype == np.uint8
    assert found.shape == exact.shape
    assert np.abs(found - exact).max() <= 0.5 + 5e-4


def stamp(ns):
    return Timestamp(seconds=ns // 10**9, nanos=ns % 10**9)


def video(packet, at, codec="h264", frame_id="cam"):
    return CompressedVideo(timestamp=stamp(at), frame_id=frame_id, data=packet, format=codec)


def calibration(frame_id="cam", size_wh=SIZE):
    K = [60.0, 0, 48, 0, 60, 32, 0, 0, 1]
    return CameraCalibration(frame_id=frame_id, width=size_wh[0], height=size_wh[1], K=K, distortion_model="plumb_bob")


def write_log(path: Path, packets, codec="h264", size_wh=SIZE, left_out=(), points_every=1):
    """An MCAP of another program: a camera as video, a LiDAR at the same instants, transforms and calibration."""
    axes = (-0.5, 0.5, -0.5, 0.5)
    with path.open("wb") as file, Writer(file) as writer:

        def put(at, topic, message):
            writer.write_message(topic, message, log_time=at, publish_time=at)

        tree = FrameTransforms(transforms=[edge("base_link", "lidar"), edge("base_link", "cam", (0, 0, 1), axes)])
        put(START, "/tf_static", tree)
        put(START, "/cam/info", calibration(size_wh=size_wh))
        for i, packet in enumerate(packets):
            at = START + i * 100 * MS
            if i % points_every == 0:
                put(at, "/points", packed(XYZ, [(10 + i, 0, 1), (11 + i, 1, 1)], timestamp=stamp(at)))
            if i not in left_out:
                put(at + MS, "/cam/video", video(packet, at, codec))
    return path
