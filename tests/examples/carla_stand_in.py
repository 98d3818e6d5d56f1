"""A stand-in for CARLA's client and server: a straight road in Unreal's axes (x forward, y right, z up), with boxes.

It has the names and signatures that `examples/carla` uses of the real package, which `test_carla` compares with it.
Parameters without a name in the package are positional here. Everything is computed in Unreal's axes.
"""

import fnmatch
import signal
from dataclasses import dataclass, field
from enum import IntEnum
from types import ModuleType, SimpleNamespace

import numpy as np


class CityObjectLabel(IntEnum):
    Car = 14
    Truck = 15
    Bus = 16
    Motorcycle = 18
    Bicycle = 19

    def __str__(self):
        return self.name


class LaneType(IntEnum):
    Driving = 2
    Sidewalk = 32

    def __str__(self):
        return self.name


@dataclass
class Vector3D:
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


class Location(Vector3D):
    pass


@dataclass
class Rotation:
    pitch: float = 0.0
    yaw: float = 0.0
    roll: float = 0.0


@dataclass
class Transform:
    location: Location = field(default_factory=Location)
    rotation: Rotation = field(default_factory=Rotation)


@dataclass
class BoundingBox:
    location: Location
    extent: Vector3D
    rotation: Rotation = field(default_factory=Rotation, init=False)


@dataclass
class WeatherParameters:
    cloudiness: float = 0.0
    precipitation: float = 0.0
    precipitation_deposits: float = 0.0
    wind_intensity: float = 0.0
    sun_azimuth_angle: float = 0.0
    sun_altitude_angle: float = 0.0
    fog_density: float = 0.0
    fog_distance: float = 0.0
    fog_falloff: float = 0.0
    wetness: float = 0.0
    scattering_intensity: float = 0.0
    mie_scattering_scale: float = 0.0


@dataclass
class WorldSettings:
    synchronous_mode: bool = False
    no_rendering_mode: bool = False
    fixed_delta_seconds: float | None = None


@dataclass
class Server:
    """What the server is like, what happens to it, and what is left of a recording."""

    version: str = "0.9.16"
    is_there: bool = True
    busy_ports: tuple[int, ...] = ()
    dies_at: int | None = None  # Tick
    silent_at: int | None = None
    interrupted_at: int | None = None
    lacks: str = ""  # Blueprint
    settings: WorldSettings = field(default_factory=WorldSettings)
    actors: dict[int, "Actor"] = field(default_factory=dict)
    traffic_is_synchronous: bool = False
    weather: WeatherParameters | None = None
    num_actors: int = 0  # Ever spawned

    def answer(self):
        if not self.is_there:
            raise RuntimeError("time-out of 5000ms while waiting for the simulator, make sure it is ready")


@dataclass
class ActorAttribute:
    recommended_values: list[str]


class ActorBlueprint:
    def __init__(self, name, **attributes):
        self.id, self._attributes = name, attributes

    def has_attribute(self, name, /):
        return name in self._attributes

    def get_attribute(self, name, /):
        return ActorAttribute([self._attributes[name]])

    def set_attribute(self, name, value, /):
        assert isinstance(value, str)
        self._attributes[name] = value


class BlueprintLibrary(list[ActorBlueprint]):
    def filter(self, wildcard_pattern):
        return BlueprintLibrary(one for one in self if fnmatch.fnmatch(one.id, wildcard_pattern))

    def find(self, id):  # noqa: A002  # the package's name
        for one in self:
            if one.id == id:
                return one
        raise IndexError(f"blueprint '{id}' not found")


def _library():
    sensors = ("camera.rgb", "camera.depth", "lidar.ray_cast", "other.radar")
    return BlueprintLibrary([
        ActorBlueprint("vehicle.tesla.model3", base_type="car", number_of_wheels="4", color="1,2,3"),
        ActorBlueprint("vehicle.bh.crossbike", base_type="bicycle", number_of_wheels="2"),
        ActorBlueprint("walker.pedestrian.0001"), ActorBlueprint("controller.ai.walker"),
        *(ActorBlueprint(f"sensor.{name}") for name in sensors),
    ])  # fmt: skip


class Actor:
    def __init__(self, world, number, kind, place, parent=None):
        self._world, self.id, self.type_id = world, number, kind.id
        self.attributes, self._place, self._parent = dict(kind._attributes), place, parent
        half, up, self._speed = (2.2, 0.9, 0.75), 0.75, 10.0 if place.location.y > 0 else 8.0
        if self.type_id.startswith("walker"):
            half, up, self._speed = (0.2, 0.2, 0.9), 0.0, 1.5
        elif "bike" in self.type_id:
            half, up = (0.8, 0.0, 0.9), 0.9  # as servers had it
        self.bounding_box = BoundingBox(Location(0, 0, up), Vector3D(*half))

    def destroy(self):
        self._world._server.answer()
        del self._world._server.actors[self.id]
        return True

    def _now(self):
        """Where it is: on its way along x."""
        at, far = self._place.location, self._world._time_s * self._speed
        if self._parent is None:
            return Transform(Location(at.x + far, at.y, 0.9 if self.type_id.startswith("walker") else 0.0), Rotation())
        base = self._parent._now().location
        return Transform(Location(base.x + at.x, base.y + at.y, base.z + at.z), self._place.rotation)


class Vehicle(Actor):
    def set_autopilot(self, enabled=True, tm_port=8000):
        assert (enabled, tm_port) == (True, 8000)

    def get_physics_control(self):
        at = self._now().location
        wheels = [Vector3D(100 * (at.x + x), 100 * (at.y + y), 30) for x in (1.5, -1.4) for y in (-0.8, 0.8)]
        return VehiclePhysicsControl([WheelPhysicsControl(position) for position in wheels])


@dataclass
class WheelPhysicsControl:
    position: Vector3D


@dataclass
class VehiclePhysicsControl:
    wheels: list[WheelPhysicsControl]


class Walker(Actor):
    pass


class WalkerAIController(Actor):
    def start(self):
        self._started = True

    def stop(self):
        pass

    def go_to_location(self, destination):
        assert self._started

    def set_max_speed(self, speed):
        assert 0.5 < speed < 2


class Sensor(Actor):
    _callback = None

    def listen(self, callback):
        self._callback = callback

    def stop(self):
        self._callback = None


class ActorList(list[Actor]):
    def filter(self, wildcard_pattern):
        return ActorList(one for one in self if fnmatch.fnmatch(one.type_id, wildcard_pattern))


class ActorSnapshot:
    def __init__(self, actor):
        self._place, self._velocity = actor._now(), Vector3D(actor._speed, 0, 0)

    def get_transform(self):
        return self._place

    def get_velocity(self):
        return self._velocity


class WorldSnapshot:
    def __init__(self, actors):
        self._found = {actor.id: ActorSnapshot(actor) for actor in actors}

    def find(self, actor_id):
        return self._found.get(actor_id)


@dataclass
class EnvironmentObject:
    id: int
    name: str
    bounding_box: BoundingBox


class Waypoint:
    """On a road along x: a driving lane of 4 m around y = 0, a sidewalk of 2 m to the right of it."""

    road_id, section_id = 7, 0

    def __init__(self, s, lane_id=-1):
        self.s, self.lane_id = s, lane_id
        self.lane_type, self.lane_width, y = {-1: (LaneType.Driving, 4.0, 0.0), -2: (LaneType.Sidewalk, 2.0, 3.0)}[
            lane_id
        ]
        self.transform = Transform(Location(s, y, 0), Rotation())

    def get_right_lane(self):
        return Waypoint(self.s, -2) if self.lane_id == -1 else None


class Map:
    def get_spawn_points(self):
        return [Transform(Location(14.0 * k, y, 0.3), Rotation()) for k in range(3) for y in (0.0, 3.5)]

    def generate_waypoints(self, distance):
        return [Waypoint(s) for s in np.arange(0.0, 100.0, distance)]


class TrafficManager:
    def __init__(self, server):
        self._server = server

    def set_synchronous_mode(self, mode_switch):
        self._server.traffic_is_synchronous = mode_switch

    def set_random_device_seed(self, value):
        pass

    def update_vehicle_lights(self, actor, do_update):
        assert isinstance(do_update, bool)


class World:
    def __init__(self, server):
        self._server, self._frame, self._time_s = server, 100, 0.0

    def get_settings(self):
        self._server.answer()
        return WorldSettings(**vars(self._server.settings))

    def apply_settings(self, settings):
        self._server.settings = settings
        return self._frame

    def set_pedestrians_seed(self, seed):
        pass

    def set_weather(self, weather, /):
        self._server.weather = weather

    def get_map(self):
        return Map()

    def get_blueprint_library(self):
        return BlueprintLibrary(one for one in _library() if one.id != self._server.lacks)

    def get_random_location_from_navigation(self):
        return Location(20.0, 7.0, 0.2)

    def get_environment_objects(self, object_type=CityObjectLabel.Car):
        parked = BoundingBox(Location(30.0, -6.0, 0.8), Vector3D(2.3, 1.0, 0.8))
        parked.rotation.yaw = 90.0
        return [EnvironmentObject(2**63 + 5, "ParkedCar_3", parked)] if object_type == CityObjectLabel.Car else []

    def try_spawn_actor(self, blueprint, transform, attach_to=None):
        taken = [actor for actor in self._server.actors.values() if isinstance(actor, Walker)]
        if blueprint.id.startswith("walker") and taken:
            return None  # all come to one place
        return self.spawn_actor(blueprint, transform, attach_to)

    def spawn_actor(self, blueprint, transform, attach_to=None):
        self._server.num_actors += 1
        kinds = {"vehicle": Vehicle, "walker": Walker, "controller": WalkerAIController, "sensor": Sensor}
        kind = kinds[blueprint.id.partition(".")[0]]
        number = 40 + self._server.num_actors
        self._server.actors[number] = actor = kind(self, number, blueprint, transform, attach_to)
        return actor

    def get_actors(self):
        return ActorList(self._server.actors.values())

    def get_snapshot(self):
        return WorldSnapshot(self._server.actors.values())

    def tick(self):
        server = self._server
        assert server.settings.synchronous_mode
        assert server.traffic_is_synchronous
        self._frame += 1
        self._time_s += server.settings.fixed_delta_seconds
        server.is_there &= self._frame != server.dies_at
        server.answer()
        if self._frame == server.interrupted_at:
            signal.raise_signal(signal.SIGINT)
        for sensor in [one for one in server.actors.values() if isinstance(one, Sensor) and one._callback]:
            if self._frame != server.silent_at:
                sensor._callback(_measure(self, sensor))
        return self._frame


def client_of(server):
    class Client:
        def __init__(self, host="127.0.0.1", port=2000):
            pass

        def set_timeout(self, seconds):
            pass

        def get_server_version(self):
            server.answer()
            return server.version

        def get_client_version(self):
            return "0.9.16"

        def get_available_maps(self):
            return ["/Game/Carla/Maps/Town01", "/Game/Carla/Maps/Town03"]

        def get_trafficmanager(self, port=8000):
            if port in server.busy_ports:
                raise RuntimeError("trying to create rpc server for traffic manager; bind error")
            return TrafficManager(server)

        def load_world(self, map_name):
            assert map_name in ("Town01", "Town03")
            return World(server)

    return Client


NAMES = (
    "ActorAttribute", "ActorBlueprint", "ActorList", "ActorSnapshot", "BlueprintLibrary", "BoundingBox",
    "CityObjectLabel", "EnvironmentObject", "LaneType", "Location", "Map", "Rotation", "Sensor", "TrafficManager",
    "Transform", "Vector3D", "Vehicle", "VehiclePhysicsControl", "Walker", "WalkerAIController", "Waypoint",
    "WeatherParameters", "WheelPhysicsControl", "World", "WorldSettings", "WorldSnapshot",
)  # fmt: skip


def package(server):
    """Return what `import carla` gives."""
    module = ModuleType("carla")
    for name in NAMES:
        setattr(module, name, globals()[name])
    setattr(module, "Client", client_of(server))  # noqa: B010  # a module declares nothing
    return module


def _measure(world, sensor):
    place, own = sensor._now(), sensor.attributes
    data = SimpleNamespace(frame=world._frame)
    if "camera" in sensor.type_id:
        data.width, data.height = int(own["image_size_x"]), int(own["image_size_y"])
        f = data.width / 2 / np.tan(np.radians(float(own["fov"])) / 2)
        v, u = np.indices((data.height, data.width))
        rays = np.stack([np.ones(u.shape), (u + 0.5 - data.width / 2) / f, (data.height / 2 - v - 0.5) / f], axis=-1)
        depth, which = _cast(world, sensor, place, rays.reshape(-1, 3))  # in units of the ray: along the axis
        if "depth" in sensor.type_id:
            code = (np.minimum(depth, 1000) / 1000 * (2**24 - 1)).astype(np.int64)
            bgra = np.stack([code >> 16, code >> 8 & 255, code & 255, np.full(len(code), 255)], axis=1)
        else:
            gray = np.clip(200 - 40 * which, 0, 255)
            bgra = np.stack([gray, gray, np.full(len(gray), 90), np.full(len(gray), 255)], axis=1)
        data.raw_data = bgra.astype(np.uint8).tobytes()
        return data
    if "lidar" in sensor.type_id:
        channels, num = int(own["channels"]), int(own["points_per_second"]) / float(own["rotation_frequency"])
        altitude = np.radians(np.linspace(float(own["upper_fov"]), float(own["lower_fov"]), channels))[:, None]
        azimuth = np.linspace(-np.pi, np.pi, int(num / channels), endpoint=False)
        flat = np.cos(altitude)
        up = np.broadcast_to(np.sin(altitude), (channels, len(azimuth)))
        rays = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), up], axis=-1)
        depth, _ = _cast(world, sensor, place, rays.reshape(-1, 3))
        hit = depth < float(own["range"])
        counts = hit.reshape(channels, -1).sum(axis=1)
        xyz = rays.reshape(-1, 3)[hit] * depth[hit, None]
        data.channels, data.get_point_count = channels, lambda channel: int(counts[channel])
        data.raw_data = np.column_stack([xyz, np.exp(-0.004 * depth[hit])]).astype(np.float32).tobytes()
        return data
    wide, high = (np.radians(float(own[name])) / 2 for name in ("horizontal_fov", "vertical_fov"))
    azimuth, altitude = (one.ravel() for one in np.meshgrid(np.linspace(-wide, wide, 60), np.linspace(-high, high, 30)))
    rays = np.stack([np.cos(altitude) * np.cos(azimuth), np.cos(altitude) * np.sin(azimuth), np.sin(altitude)], axis=1)
    depth, which = _cast(world, sensor, place, rays)
    hit = depth < float(own["range"])
    speeds = np.array([0.0, *(speed for *_, speed in _boxes(world, sensor))])[which[hit]]
    ahead = (rays @ _rotation(place.rotation).T)[hit, 0]
    velocity = (speeds - sensor._parent._speed) * ahead  # positive when receding, as the server's source has it
    data.raw_data = np.column_stack([velocity, azimuth[hit], altitude[hit], depth[hit]]).astype(np.float32).tobytes()
    return data


def _boxes(world, sensor):
    """Middle, half size as they lie along x and y, and speed of all but the vehicle that carries the sensor."""
    found = [((30.0, -6.0, 0.8), (1.0, 2.3, 0.8), 0.0)]
    for actor in world._server.actors.values():
        if isinstance(actor, (Vehicle, Walker)) and actor is not sensor._parent:
            at, own = actor._now().location, actor.bounding_box
            found.append(
                (
                    (at.x, at.y, at.z + own.location.z),
                    (own.extent.x, max(own.extent.y, 0.3), own.extent.z),
                    actor._speed,
                )
            )
    return found


def _rotation(rotation):
    """Columns: the sensor's x, y, z in the world; yaw and pitch only, both as Unreal turns them."""
    yaw, pitch = np.radians([rotation.yaw, rotation.pitch])
    (cy, sy), (cp, sp) = (np.cos(yaw), np.sin(yaw)), (np.cos(pitch), np.sin(pitch))
    return np.array([[cp * cy, -sy, -cy * sp], [cp * sy, cy, -sy * sp], [sp, 0, cp]])


def _cast(world, sensor, place, rays):
    """How far (N,) rays in the sensor's axes go, as multiples of themselves, and what they hit: 0 is the ground."""
    rays = rays @ _rotation(place.rotation).T
    start = np.array([place.location.x, place.location.y, place.location.z])
    with np.errstate(divide="ignore", invalid="ignore"):
        far = np.where(rays[:, 2] < 0, -start[2] / rays[:, 2], np.inf)
        which = np.zeros(len(rays), np.int64)
        for number, (middle, half, _) in enumerate(_boxes(world, sensor), 1):
            sides = (np.array([[-1.0], [1.0]]) * half + middle - start)[:, None] / rays
            enter, leave = sides.min(axis=0).max(axis=1), sides.max(axis=0).min(axis=1)
            nearer = (enter <= leave) & (enter > 0) & (enter < far)
            far, which = np.where(nearer, enter, far), np.where(nearer, number, which)
    return far, which
