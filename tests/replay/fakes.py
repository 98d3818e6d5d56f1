"""A log in memory and small pipelines, for tests of the loop."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.messages import Message, PointCloud, Pose, RadarScan, Truth
from fbench.replay.data.rig import LogInfo, Mount, Rig

UPRIGHT = np.array([0.0, 0, 0, 1])
MS = 1_000_000
RIG = Rig({"lidar": Mount("lidar", np.zeros(3), UPRIGHT), "radar": Mount("radar", np.zeros(3), UPRIGHT)}, {})


@dataclass
class FakeLog:
    """A reader over lists."""

    items: list[Message]
    labels: list[Truth] = field(default_factory=list)
    rig: Rig = RIG
    info: LogInfo = field(default_factory=lambda: LogInfo("fake", "fake-1", {"place": "here"}))

    @property
    def num_messages(self) -> Mapping[str, int]:
        return Counter(m.sensor for m in self.items)

    @property
    def poses(self) -> tuple[str, ...]:
        return tuple(sorted({m.sensor for m in self.items if isinstance(m, Pose)}))

    def messages(self) -> Iterator[Message]:
        return iter(sorted(self.items, key=lambda m: (m.log_ns, m.sensor)))

    def events(self) -> Iterator[Message]:
        return self.messages()

    def truths(self) -> Iterator[Truth]:
        return iter(self.labels)


def box(x: float, **fields: object) -> Boxes3D:
    one = Boxes3D(np.array([[x, 0.0, 0.0]]), np.array([[4.0, 2, 1.5]]), np.zeros(1), score=np.ones(1))
    return Boxes3D(**{**one.arrays(), **fields})


def cloud(stamp_ns: int, x: float = 10.0, sensor: str = "lidar", late_ns: int = 0) -> PointCloud:
    xyz = np.array([[x, 0, 0], [x + 1, 0, 0]], np.float32)
    return PointCloud(sensor, stamp_ns, stamp_ns + late_ns, xyz)


def scan(stamp_ns: int, x: float = 10.0) -> RadarScan:
    return RadarScan("radar", stamp_ns, stamp_ns, np.array([[x, 0, 0]], np.float32), np.ones(1, np.float32))


def drive(num_frames: int = 20) -> FakeLog:
    """LiDAR and radar at 10 Hz, a car that drives away, truth in every second frame."""
    stamps = [100 * MS * i for i in range(num_frames)]
    items: list[Message] = [m for i, s in enumerate(stamps) for m in (cloud(s, 10.0 + i), scan(s, 10.0 + i))]
    labels = [Truth(s, s, box(10.0 + i, track_id=np.array([7]))) for i, s in enumerate(stamps) if i % 2 == 0]
    return FakeLog(items, labels)


class Echo:
    """A box at the first LiDAR point of every frame, with a track that counts frames since the last reset."""

    def __init__(self) -> None:
        self.age = 0
        self.resets: list[str] = []

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        self.rig = rig

    def reset(self, reason: str) -> None:
        self.age = 0
        self.resets.append(reason)

    def step(self, frame: Frame) -> Output:
        self.age += 1
        message = frame.messages.get("lidar")
        found = (
            box(float(message.xyz[0, 0])) if isinstance(message, PointCloud) and len(message.xyz) else Boxes3D.empty()
        )
        tracks = Boxes3D(**{**found.arrays(), "track_id": np.full(len(found), self.age)})
        return Output(found, tracks, {"detect.lidar": 1000, "track": 500})
