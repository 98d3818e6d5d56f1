"""Reading and decoding cameras recorded as H.264, as multiples of plain decoding by PyAV of the same packets.

python benchmarks/bench_video.py [PICTURES]
"""

import sys
import tempfile
import time
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from common import UPRIGHT, best_s

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.images import decode
from fbench.replay.data.messages import Image
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.logs.containers.mcap.write import McapWriter
from fbench.replay.logs.open import open_log

SIZE_WH = (1280, 720)
RIG = Rig({"cam": Mount("camera", np.zeros(3), UPRIGHT)}, {"cam": CameraModel(np.eye(3), SIZE_WH)})


def encode(num: int) -> list[bytes]:
    """A keyframe a second, of a scene that moves."""
    width, height = SIZE_WH
    context = av.CodecContext.create("libx264", "w")
    context.width, context.height, context.pix_fmt, context.gop_size = width, height, "yuv420p", 30
    context.time_base, context.framerate, context.options = Fraction(1, 30), 30, {"tune": "zerolatency"}
    rng = np.random.Generator(np.random.Philox(1))
    coarse = rng.integers(0, 255, (height // 8, (width + 4 * num) // 8 + 1, 3)).astype(np.uint8)
    scene = coarse.repeat(8, axis=0).repeat(8, axis=1)
    packets = []
    for i in range(num):
        pixels = np.ascontiguousarray(scene[:height, 4 * i : 4 * i + width])
        packets += context.encode(av.VideoFrame.from_ndarray(pixels, format="bgr24"))
    return [bytes(packet) for packet in [*packets, *context.encode(None)]]


def decode_plainly(packets: list[bytes]) -> int:
    """Decode to BGR in order, in one thread."""
    context = av.CodecContext.create("h264", "r")
    context.thread_count = 1
    frames = (frame for packet in packets for frame in context.decode(av.Packet(packet)))
    return sum(frame.to_ndarray(format="bgr24").shape[0] > 0 for frame in frames)


def read(path: Path, every: int = 0) -> int:
    """Read a log, and decode every so many pictures; 0: none."""
    images = (message for message in open_log(path, FaultLog()).messages() if isinstance(message, Image))
    return sum(every > 0 and i % every == 0 and decode(image) is not None for i, image in enumerate(images))


def main() -> None:
    packets = encode(int(sys.argv[1]) if len(sys.argv) > 1 else 120)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"
        with McapWriter(path, LogInfo("bench", "bench"), RIG) as log:
            for i, packet in enumerate(packets):
                log.write(Image("cam", 33_000_000 * i + 1, 33_000_000 * i + 1, packet, "h264", (0, 0)))
        assert read(path, 1) == decode_plainly(packets) == len(packets)
        times = {
            "plain": best_s(lambda: decode_plainly(packets), 3, time.process_time),
            "every picture": best_s(lambda: read(path, 1), 3, time.process_time),
            "every third picture": best_s(lambda: read(path, 3), 3, time.process_time),
            "no picture": best_s(lambda: read(path), 3, time.process_time),
        }
    each_ms = 1e3 * times["plain"] / len(packets)
    print(f"{len(packets)} pictures of {SIZE_WH[0]}x{SIZE_WH[1]} px, {each_ms:.1f} ms each by plain PyAV; CPU time:")
    for name in ("every picture", "every third picture", "no picture"):
        print(f"{name}: {times[name] / times['plain']:.2f} of the time of plain PyAV")


if __name__ == "__main__":
    main()
