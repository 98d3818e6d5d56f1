"""A world of CARLA in synchronous mode, with traffic and sensors: set up, stepped, and left as it was found."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any, Self

import conversions
import numpy as np
import truth
from truth import Body

from fbench.datasets.city.rig import CameraSpec, LidarSpec, RadarSpec, RigSpec
from fbench.datasets.city.spec import Condition
from fbench.replay.conditions.generators import generator
from fbench.replay.contracts.errors import ConfigError, LogError, did_you_mean
from fbench.replay.data.arrays import Float64

VERSION = "0.9.16"
_PARKED_ID = 1_000_000_000  # Track ids from here on are of vehicles that belong to the map


@dataclass(frozen=True)
class Request:
    """What to record, and where the server is."""

    town: str
    condition: Condition
    seconds: float
    seed: int
    rig: RigSpec
    vehicles: int
    pedestrians: int
    ego: str = "vehicle.tesla.model3"
    warm_up_s: float = 3.0
    host: str = "127.0.0.1"
    port: int = 2000
    tm_port: int = 8000
    timeout_s: float = 60.0

    @property
    def rate_hz(self) -> float:
        """Ticks a second: as the fastest sensor measures."""
        return max(spec.rate_hz for spec in self.rig.specs.values())

    def every(self, name: str) -> int:
        """Return at which ticks a sensor measures. Raises ConfigError where its rate doesn't divide that of the ticks,
        or a LiDAR would be between two directions.
        """
        spec = self.rig.specs[name]
        ticks = round(self.rate_hz / spec.rate_hz)
        if abs(ticks * spec.rate_hz - self.rate_hz) > 1e-6 or (isinstance(spec, LidarSpec) and ticks != 1):
            what = "turns once a tick" if isinstance(spec, LidarSpec) else "measures at whole ticks"
            raise ConfigError(
                f"'{name}': {spec.rate_hz:g} Hz, but in CARLA it {what}, which are {self.rate_hz:g} a second"
            )
        return ticks


@contextmanager
def translate_errors(request: Request) -> Iterator[None]:
    """Turn what CARLA raises into an error of fbench, in a line."""
    try:
        yield
    except (RuntimeError, IndexError) as error:  # the latter of a blueprint that the server lacks
        reason = next(iter(str(error).splitlines()), type(error).__name__)
        raise LogError(f"CARLA at {request.host}:{request.port}: {reason}") from error


class Simulation:
    """A world in synchronous mode with our traffic and sensors; when it ends, the server is as it was found."""

    def __init__(self, carla: Any, request: Request) -> None:
        self._carla, self._request = carla, request
        self._actors: list[Any] = []  # In the order in which they came
        self._queues: dict[str, SimpleQueue[Any]] = {}
        self._listening: list[Any] = []
        self._world: Any = None
        self._traffic: Any = None
        self._client = carla.Client(request.host, request.port)

    def __enter__(self) -> Self:
        try:
            self._connect()
            with translate_errors(self._request):
                self._prepare()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _connect(self) -> None:
        """See that a server of our version is there, with the town."""
        request, client = self._request, self._client
        client.set_timeout(min(request.timeout_s, 5.0))
        try:
            versions = client.get_server_version(), client.get_client_version()
        except RuntimeError as error:
            where = f"{request.host}:{request.port}"
            raise ConfigError(f"no CARLA server answers at {where}; start it, or choose --host and --port") from error
        for who, version in zip(("server", "client"), versions, strict=True):
            if version != VERSION:
                raise ConfigError(f"the {who} is CARLA {version}, expected {VERSION}")
        client.set_timeout(request.timeout_s)
        with translate_errors(request):
            towns = {path.rsplit("/", 1)[-1] for path in client.get_available_maps()}
        if request.town not in towns:
            raise ConfigError(f"the server has no map '{request.town}'{did_you_mean(request.town, towns)}")

    def _prepare(self) -> None:
        """Load the town and spawn all who move in it; then let them come to their speed."""
        carla, request = self._carla, self._request
        self._world = world = self._client.load_world(request.town)
        try:
            self._traffic = traffic = self._client.get_trafficmanager(request.tm_port)
        except RuntimeError as error:
            raise ConfigError(f"port {request.tm_port} of the traffic manager is in use; choose --tm-port") from error
        settings = world.get_settings()
        settings.synchronous_mode, settings.fixed_delta_seconds = True, 1.0 / request.rate_hz
        world.apply_settings(settings)
        traffic.set_synchronous_mode(True)
        traffic.set_random_device_seed(request.seed % 2**31)
        world.set_pedestrians_seed(request.seed % 2**31)
        air = carla.WeatherParameters()
        for name, value in conversions.weather(request.condition.weather).items():
            setattr(air, name, value)
        world.set_weather(air)
        self.map = world.get_map()
        self._parked = list(_find_parked(carla, world))
        self._library = world.get_blueprint_library()
        self._spawn_vehicles()
        self._spawn_pedestrians()
        for name, spec in request.rig.specs.items():
            self._attach(name, spec, *conversions.blueprint(spec, request.seed % 2**31))
        for yaw_deg in truth.FACES_DEG:
            spec = truth.face(yaw_deg)
            self._attach(f"depth {yaw_deg:g}", spec, "sensor.camera.depth", conversions.pinhole(spec))
        for _ in range(max(1, round(request.warm_up_s * request.rate_hz))):
            snapshot, _ = self.tick()
        self._shapes = [_shape(actor) for kind in ("vehicle.*", "walker.*") for actor in world.get_actors().filter(kind)
                        if actor.id != self._ego.id]  # fmt: skip
        wheels = [wheel.position for wheel in self._ego.get_physics_control().wheels]
        self.rear_axle_m = conversions.rear_axle_m(wheels, self.pose(snapshot))

    def _spawn_vehicles(self) -> None:
        """Put the ego and the traffic on spawn points of the town; fewer where it hasn't so many."""
        request, world = self._request, self._world
        random = generator(request.seed, "carla", "vehicles")
        places = self.map.get_spawn_points()
        order = random.permutation(len(places))
        kinds = sorted(self._library.filter("vehicle.*"), key=lambda one: one.id)
        known = {kind.id: kind for kind in kinds}
        if request.ego not in known:
            raise ConfigError(f"--ego {request.ego}: no vehicle of the server{did_you_mean(request.ego, known)}")
        is_dark = request.condition.weather.sun_elevation_deg < 0
        for number, place in enumerate(order[: request.vehicles + 1]):
            kind = kinds[random.integers(len(kinds))] if number else known[request.ego]
            kind.set_attribute("role_name", "autopilot" if number else "hero")
            if number and kind.has_attribute("color"):
                colors = kind.get_attribute("color").recommended_values
                kind.set_attribute("color", colors[random.integers(len(colors))])
            vehicle = world.try_spawn_actor(kind, places[place])
            if vehicle is None:
                if not number:
                    raise LogError(f"'{request.ego}' can't be spawned in {request.town}: something is in its place")
                continue
            self._actors.append(vehicle)
            if not number:
                self._ego = vehicle
            vehicle.set_autopilot(True, request.tm_port)
            self._traffic.update_vehicle_lights(vehicle, is_dark)
        if not len(order):
            raise LogError(f"{request.town} has no spawn points")

    def _spawn_pedestrians(self) -> None:
        """Put pedestrians on sidewalks, each with a controller that walks it to another place."""
        carla, world = self._carla, self._world
        random = generator(self._request.seed, "carla", "pedestrians")
        kinds = sorted(self._library.filter("walker.pedestrian.*"), key=lambda one: one.id)
        controller, controllers = self._library.find("controller.ai.walker"), []
        for _ in range(self._request.pedestrians if kinds else 0):
            place, speed_mps = world.get_random_location_from_navigation(), float(random.uniform(0.8, 1.8))
            kind = kinds[random.integers(len(kinds))]
            walker = None if place is None else world.try_spawn_actor(kind, carla.Transform(place, carla.Rotation()))
            if walker is not None:
                self._actors.append(walker)
                self._actors.append(world.spawn_actor(controller, carla.Transform(), walker))
                controllers.append((self._actors[-1], speed_mps))
        world.tick()  # only then controllers can be started
        for one, speed_mps in controllers:
            one.start()
            if (goal := world.get_random_location_from_navigation()) is not None:
                one.go_to_location(goal)
            one.set_max_speed(speed_mps)

    def _attach(
        self, name: str, spec: CameraSpec | LidarSpec | RadarSpec, kind: str, attributes: Mapping[str, str]
    ) -> None:
        carla, found = self._carla, self._library.find(kind)
        for key, value in attributes.items():
            found.set_attribute(key, value)
        (x, y, z), (pitch, yaw, roll) = conversions.mount(spec)
        place = carla.Transform(carla.Location(x, y, z), carla.Rotation(pitch, yaw, roll))
        sensor = self._world.spawn_actor(found, place, self._ego)
        self._actors.append(sensor)
        self._queues[name] = SimpleQueue()
        sensor.listen(self._queues[name].put)
        self._listening.append(sensor)

    def tick(self) -> tuple[Any, dict[str, Any]]:
        """Go on by one step; return its snapshot and what each sensor gave. Raises LogError where one gives nothing."""
        frame = self._world.tick()
        return self._world.get_snapshot(), {name: self._take(name, frame) for name in self._queues}

    def _take(self, name: str, frame: int) -> Any:
        try:
            while (data := self._queues[name].get(timeout=self._request.timeout_s)).frame != frame:
                pass
        except Empty:
            wait = f"{self._request.timeout_s:g} s"
            raise LogError(f"the server gave nothing of sensor '{name}' in step {frame} within {wait}") from None
        return data

    def pose(self, snapshot: Any) -> Float64:
        """Return `world_T_body` (4, 4). The body's origin is the vehicle's: about its middle, on the ground."""
        place = snapshot.find(self._ego.id).get_transform()
        return conversions.matrix(place.location, place.rotation)

    def bodies(self, snapshot: Any) -> list[Body]:
        """Return all road users but the ego vehicle."""
        found = list(self._parked)
        for shape in self._shapes:
            now = snapshot.find(shape.track_id)
            if now is not None:
                place = now.get_transform()
                world_T_box = conversions.matrix(place.location, place.rotation) @ shape.world_T_box
                velocity = conversions.position(now.get_velocity())
                found.append(
                    Body(shape.track_id, shape.label, shape.source_label, world_T_box, shape.size_lwh_m, velocity)
                )
        return found

    def close(self) -> None:
        """Take away all that we spawned, and let the server run on its own; once is enough."""
        self._client.set_timeout(5.0)  # it may have died
        walkers = [actor for actor in self._actors if actor.type_id == "controller.ai.walker"]
        calls = [one.stop for one in (*self._listening, *walkers)] + [one.destroy for one in reversed(self._actors)]
        if self._traffic is not None:
            calls.append(partial(self._traffic.set_synchronous_mode, False))
        if self._world is not None:
            calls.append(self._end_synchronous_mode)
        self._listening, self._actors = [], []
        for call in calls:
            try:
                call()
            except RuntimeError as error:  # of an actor that is gone; the others are not
                if "time-out" in str(error):
                    break
        self._world = self._traffic = None

    def _end_synchronous_mode(self) -> None:
        settings = self._world.get_settings()
        settings.synchronous_mode, settings.fixed_delta_seconds = False, None
        self._world.apply_settings(settings)


def _shape(actor: Any) -> Body:
    """Return an actor that is at the world's origin."""
    label = conversions.label(actor.type_id, actor.attributes)
    actor_T_box, size = conversions.box(actor.bounding_box, label)
    return Body(actor.id, label, actor.type_id, actor_T_box, size, np.zeros(3))


def _find_parked(carla: Any, world: Any) -> Iterator[Body]:
    """Yield the vehicles that belong to the map, whose boxes are given in the world."""
    found = [
        (one, name.lower())
        for name in ("Car", "Truck", "Bus", "Motorcycle", "Bicycle")
        for one in world.get_environment_objects(getattr(carla.CityObjectLabel, name))
    ]
    for number, (one, label) in enumerate(sorted(found, key=lambda pair: pair[0].id)):
        own = one.bounding_box
        size = 2 * np.array([own.extent.x, own.extent.y, own.extent.z])
        if (size > 0.1).all():
            world_T_box = conversions.matrix(own.location, own.rotation)
            yield Body(_PARKED_ID + number, label, one.name, world_T_box, size, np.zeros(3), is_parked=True)
