"""What two short logs of the city are made of, written down: `python -m tests.datasets.city.pins` writes it anew."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fbench.datasets.city.recording import CityRecording
from fbench.datasets.city.rig import CameraSpec, LidarSpec, RadarSpec, RigSpec
from fbench.datasets.city.spec import VERSION, CitySpec, condition
from fbench.replay.data.images import decode
from fbench.replay.data.messages import Image, Truth
from fbench.replay.runs.digest import digest
from fbench.replay.runs.host import describe_host
from fbench.replay.runs.manifest import package_versions

PINNED = Path(__file__).with_name("pinned.json")
_DECIDE = ("numpy", "scipy", "numba", "llvmlite", "embreex", "opencv-python-headless")
RIG = RigSpec(
    cameras={"camera": CameraSpec(translation_m=(2.0, 0.0, 1.0), size_wh=(96, 72))},
    lidars={
        "lidar": LidarSpec(
            translation_m=(0.0, 0.0, 2.0), rate_hz=10.0, points_per_s=60_000, channels=32, dropout=0.02, motion=True
        )
    },
    radars={
        "radar": RadarSpec(
            translation_m=(2.0, 0.0, 1.0), points_per_s=20_000, loss=0.03, clutter=20.0, multipath=0.5, merge_cells=True
        )
    },
    pose_rate_hz=20.0,
)
SPECS: Mapping[str, CitySpec] = {
    "urban": CitySpec("urban", condition("traffic+rain"), 0.2, 5, RIG),
    "highway": CitySpec("highway", condition("fog+night"), 0.2, 6, RIG),
}


def pin(spec: CitySpec) -> dict[str, Any]:
    """Return digests of what the log's streams hold, and what its messages are about; JSON-ready."""
    log = CityRecording(spec, "pinned")
    streams: dict[str, list[Any]] = {}
    for item in log.items():
        streams.setdefault("truth" if isinstance(item, Truth) else item.sensor, []).append(item)
    digests = {name: digest(items) for name, items in sorted(streams.items())}
    digests["metadata"] = digest({"id": log.info.log_id, **log.info.metadata})
    stamps = {name: [[item.stamp_ns, item.log_ns] for item in items] for name, items in sorted(streams.items())}
    about = {name: [_about(item) for item in items] for name, items in sorted(streams.items())}
    return {"digests": digests, "stamps": stamps, "about": about}


def surroundings() -> dict[str, str]:
    """What may change the last digits: processor, and packages."""
    versions = package_versions()
    simd = {word for word in _cpuinfo().split() if word.startswith(("avx", "fma"))}
    own = {name: versions[name] for name in _DECIDE}
    return {"cpu": str(describe_host()["cpu"]), "simd": " ".join(sorted(simd)), **own}


def _cpuinfo() -> str:
    path = Path("/proc/cpuinfo")
    return path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""


def _about(item: Any) -> dict[str, float]:
    """Numbers of values and their means, which no processor changes much."""
    if isinstance(item, Image):
        colors = decode(item).reshape(-1, 3).mean(axis=0)
        return {f"color {i}": float(value) for i, value in enumerate(colors)}
    return dict(_means("", asdict(item) if is_dataclass(item) else item))


def _means(name: str, value: Any) -> Iterator[tuple[str, float]]:
    if isinstance(value, dict):
        for key in sorted(value):
            yield from _means(f"{name}{'.' if name else ''}{key}", value[key])
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
        yield f"{name} num", len(value)
        if value.size:
            yield f"{name} mean", float(np.abs(value.astype(np.float64)).mean())


def main() -> None:
    """Write the record anew."""
    record = {"version": VERSION, "made_with": surroundings(), "logs": {name: pin(s) for name, s in SPECS.items()}}
    PINNED.write_text(json.dumps(record, indent=1, allow_nan=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
