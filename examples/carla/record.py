"""Record a drive in CARLA 0.9.16 as an fbench log: the thesis's rig, its weathers, traffic, and exact truth.

    python examples/carla/record.py Town03 --condition rain --seconds 30 -o town03-rain.mcap

A server must run (`CarlaUE4.sh -RenderOffScreen`); docs/carla.md says what it does to it.
"""

import argparse
import signal
import sys
import uuid
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from threading import Event
from typing import Any

import conversions
import numpy as np
import truth
from simulation import VERSION, Request, Simulation, translate_errors

from fbench.cli.progress import import_progress
from fbench.datasets.city.request import read_rig
from fbench.datasets.city.rig import POSE, CameraSpec, LidarSpec, RadarSpec, thesis_rig
from fbench.datasets.city.spec import condition
from fbench.datasets.importing.run import write_recording
from fbench.replay.contracts.errors import ConfigError, FbenchError, MissingPackageError
from fbench.replay.contracts.params import require_between
from fbench.replay.data.arrays import Array, Float64
from fbench.replay.data.files import make_parent
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan, Truth
from fbench.replay.data.metadata import REFERENCE, REGIONS, regions_text
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.geometry.transforms import quaternion, transform
from fbench.replay.logs.convert.target import Target

START_NS = 1_700_000_000_000_000_000  # Stamp of a log's beginning, as in the simulated city
STEP_M = 2.0  # Between waypoints
_RANGES = (
    ("seconds", 0.1, 86_400), ("timeout_s", 0.001, 86_400), ("warm_up_s", 0, 3600), ("vehicles", 0, 10_000),
    ("pedestrians", 0, 10_000), ("port", 1, 65_535), ("tm_port", 1, 65_535),
)  # fmt: skip
"""Of options."""
_NUM = {False: (50, 40), True: (100, 80)}  # Vehicles and pedestrians, in normal and in dense traffic


class CarlaRecording:
    """One drive; implements `fbench.replay.contracts.protocols.Recording`."""

    def __init__(self, simulation: Simulation, request: Request, name: str) -> None:
        self.name, self.stop = name, Event()
        """Set: the log ends with this tick."""
        self._simulation, self._request = simulation, request
        self._counts: dict[str, int] = {}
        self._every = {sensor: request.every(sensor) for sensor in request.rig.names}
        self.rig: Rig = request.rig.rig()
        self.num_items = round(request.seconds * (sum(s.rate_hz for s in request.rig.specs.values()) + request.rate_hz))
        axle = simulation.rear_axle_m
        with translate_errors(request):
            outlines = conversions.regions(simulation.map.generate_waypoints(STEP_M), STEP_M)
        self.info = LogInfo(name, f"carla-{uuid.uuid4().hex[:16]}", {
            "dataset": f"CARLA {VERSION} (simulated)", "scenario": request.town, "condition": request.condition.name,
            "traffic": f"{request.vehicles} vehicles, {request.pedestrians} pedestrians", "seed": str(request.seed),
            "stamps": "when measured; everything stands still within a tick, and arrives at once",
            "body": "origin of CARLA's actor: about the middle of the vehicle, on the ground",
            **({} if axle is None else {"rear_axle_x_m": f"{axle:.3f}"}),
            REFERENCE: request.rig.reference, REGIONS: regions_text(outlines),
        })  # fmt: skip

    def items(self) -> Iterator[Message | Truth]:
        """Yield pose, messages and truth of one tick after the other."""
        request, simulation = self._request, self._simulation
        for number in range(round(request.seconds * request.rate_hz)):
            if self.stop.is_set():
                return
            stamp_ns = START_NS + round(number * 1e9 / request.rate_hz)
            with translate_errors(request):
                snapshot, data = simulation.tick()
                world_T_body = simulation.pose(snapshot)
                messages = [
                    _message(name, request.rig.specs[name], stamp_ns, data[name])
                    for name, every in self._every.items() if number % every == 0
                ]  # fmt: skip
            yield Pose(POSE, stamp_ns, stamp_ns, world_T_body[:3, 3], quaternion(world_T_body[:3, :3]))
            yield from messages
            if number % self._every[request.rig.reference] == 0:
                yield self._truth(stamp_ns, snapshot, world_T_body, data, messages)
            for message in messages:
                self._counts[message.sensor] = self._counts.get(message.sensor, 0) + 1

    def _truth(
        self, stamp_ns: int, snapshot: Any, world_T_body: Float64, data: Mapping[str, Any],
        messages: Sequence[Image | PointCloud | RadarScan],
    ) -> Truth:  # fmt: skip
        views = [data[f"depth {yaw_deg:g}"] for yaw_deg in truth.FACES_DEG]
        faces = np.array([conversions.depths_m(view.raw_data, (view.width, view.height)) for view in views])
        clouds: list[tuple[str, Array]] = [
            (self.rig.kinds[one.sensor], transform(self.rig.body_T_sensor(one.sensor), one.xyz))
            for one in messages if not isinstance(one, Image)
        ]  # fmt: skip
        found = truth.truth(stamp_ns, self._simulation.bodies(snapshot), world_T_body, faces, clouds)
        self._counts["boxes"] = self._counts.get("boxes", 0) + (0 if found.boxes3d is None else len(found.boxes3d))
        return found

    def summary(self) -> Sequence[str]:
        """Say what was recorded."""
        counts = {"boxes": 0, **self._counts}
        messages = ", ".join(f"{name} {counts.get(name, 0)}" for name in self._every)
        return [f"recorded: {self._request.town}, {self._request.condition.name}", f"messages: {messages}",
                f"truth: {counts['boxes']} boxes"]  # fmt: skip


def _message(
    name: str, spec: CameraSpec | LidarSpec | RadarSpec, stamp_ns: int, data: Any
) -> Image | PointCloud | RadarScan:
    match spec:
        case CameraSpec():
            pixels = conversions.bgr(data.raw_data, (data.width, data.height))
            jpeg = encode_jpeg(np.ascontiguousarray(pixels), spec.jpeg_quality)
            return Image(name, stamp_ns, stamp_ns, jpeg, "jpeg", spec.size_wh)
        case LidarSpec():
            counts = [data.get_point_count(channel) for channel in range(data.channels)]
            return PointCloud(name, stamp_ns, stamp_ns, *conversions.points(data.raw_data, counts))
        case RadarSpec():
            own = conversions.echoes(data.raw_data)
            return RadarScan(name, stamp_ns, stamp_ns, own.xyz, own.radial_velocity_mps, None, own.range_m,
                             own.azimuth_rad, own.altitude_rad)  # fmt: skip


def record(request: Request, out: Path, overwrite: bool) -> int:
    """Write the log `out` and return the exit code: 130 where Ctrl-C ended it early, with a whole log."""
    target = Target(out, overwrite)
    target.form  # noqa: B018  # refuses a name without a form before anything is made
    target.require_free()
    for name in request.rig.names:
        request.every(name)
    try:
        import carla
    except ImportError as error:
        raise MissingPackageError("recording needs CARLA's client; pip install 'fbench[carla]'") from error
    make_parent(out)
    with Simulation(carla, request) as simulation:
        recording = CarlaRecording(simulation, request, out.stem)

        def end_here(*_: object) -> None:
            recording.stop.set()
            signal.signal(signal.SIGINT, before)  # a second one doesn't wait

        before = signal.signal(signal.SIGINT, end_here)
        try:
            with import_progress(1) as progress:
                log = write_recording(recording, target, progress)
        finally:
            signal.signal(signal.SIGINT, before)
    print(*log.lines, f"log: {out}", sep="\n")
    if recording.stop.is_set():
        sys.stderr.write("record.py: interrupted; the log is whole up to there\n")
        return 128 + signal.SIGINT
    return 0


def _options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("town", help="a map of the server, such as Town03")
    parser.add_argument("--out", "-o", type=Path, required=True, help="FILE.mcap or FOLDER.parquet")
    parser.add_argument("--condition", default="clear", help="as of the simulated city: clear, traffic, rain+night ...")
    parser.add_argument("--seconds", type=float, default=10.0, help="length of the log")
    parser.add_argument("--seed", type=int, default=0, help="of traffic and noise")
    parser.add_argument("--rig", type=Path, help="TOML with the sensors (default: the thesis's rig)")
    parser.add_argument("--vehicles", type=int, help="default: 50, in dense traffic 100")
    parser.add_argument("--pedestrians", type=int, help="default: 40, in dense traffic 80")
    parser.add_argument("--ego", default=Request.ego, help="blueprint of the vehicle with the sensors")
    parser.add_argument("--warm-up-s", type=float, default=Request.warm_up_s, help="before the log begins")
    parser.add_argument("--host", default=Request.host)
    parser.add_argument("--port", type=int, default=Request.port)
    parser.add_argument("--tm-port", type=int, default=Request.tm_port, help="of the traffic manager")
    parser.add_argument("--timeout-s", type=float, default=Request.timeout_s, help="how long the server may take")
    parser.add_argument("--overwrite", action="store_true", help="replace an existing log")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the command line and return the exit code."""
    options = _options().parse_args(arguments)
    try:
        under = condition(options.condition)
        vehicles, pedestrians = _NUM[under.is_dense]
        rig = thesis_rig() if options.rig is None else read_rig(options.rig)
        if not rig.names:
            raise ConfigError("the rig has no sensor")
        for name, low, high in _RANGES:
            if (value := getattr(options, name)) is not None:
                require_between(f"--{name.replace('_', '-')}", value, low, high)
        request = Request(
            options.town, under, options.seconds, options.seed, rig,
            vehicles if options.vehicles is None else options.vehicles,
            pedestrians if options.pedestrians is None else options.pedestrians, options.ego, options.warm_up_s,
            options.host, options.port, options.tm_port, options.timeout_s,
        )  # fmt: skip
        return record(request, options.out, options.overwrite)
    except FbenchError as error:
        sys.stderr.write(f"record.py: {error}\n")
        return error.exit_code
    except KeyboardInterrupt:
        sys.stderr.write("record.py: interrupted; nothing written\n")
        return 128 + signal.SIGINT


if __name__ == "__main__":
    sys.exit(main())
