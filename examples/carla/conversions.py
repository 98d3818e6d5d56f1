"""From CARLA's units and axes to fbench's: pure functions, which need no CARLA.

Unreal's axes are left-handed: x forward, y right, z up. Its yaw turns x to y (to the right), its pitch lifts the nose,
its roll lowers the right side. fbench's are right-handed: x forward, y left, z up. So y, yaw and pitch change sign, and
x, z and roll stay. CARLA's clients get meters, degrees, and m/s, but for the radar's angles (rad) and wheels (cm).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from fbench.datasets.city.rig import CameraSpec, LidarSpec, RadarSpec
from fbench.replay.conditions.weather import Weather
from fbench.replay.data.arrays import Array, Float32, Float64
from fbench.replay.data.metadata import Region
from fbench.replay.geometry.transforms import inverse, transform


def position(location: Any) -> Float64:
    """Return a location, or any vector such as a velocity, in fbench's axes (3,)."""
    return np.array([location.x, -location.y, location.z], np.float64)


def matrix(location: Any, rotation: Any) -> Float64:
    """Return `parent_T_child` (4, 4) in fbench's axes: R = Rz(-yaw) Ry(-pitch) Rx(roll)."""
    found = np.eye(4)
    angles = [-rotation.yaw, -rotation.pitch, rotation.roll]
    found[:3, :3] = Rotation.from_euler("ZYX", angles, degrees=True).as_matrix()
    found[:3, 3] = position(location)
    return found


def mount(spec: CameraSpec | LidarSpec | RadarSpec) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return where CARLA attaches a sensor to its vehicle: x, y, z [m] and pitch, yaw, roll [degrees]."""
    (x, y, z), (yaw, pitch, roll) = spec.translation_m, spec.yaw_pitch_roll_deg
    return (x, 0.0 - y, z), (0.0 - pitch, 0.0 - yaw, roll)  # 0.0 - 0.0 has no sign


def blueprint(spec: CameraSpec | LidarSpec | RadarSpec, seed: int) -> tuple[str, dict[str, str]]:
    """Return the blueprint of a sensor and its attributes."""
    match spec:
        case CameraSpec():
            return "sensor.camera.rgb", pinhole(spec)
        case LidarSpec():
            return "sensor.lidar.ray_cast", {
                "channels": str(spec.channels), "points_per_second": str(spec.points_per_s),
                "rotation_frequency": str(spec.rate_hz), "range": str(spec.range_m), "upper_fov": str(spec.upper_deg),
                "lower_fov": str(spec.lower_deg), "noise_stddev": str(spec.noise_m), "noise_seed": str(seed),
            }  # fmt: skip
        case RadarSpec():
            return "sensor.other.radar", {
                "horizontal_fov": str(spec.horizontal_fov_deg), "vertical_fov": str(spec.vertical_fov_deg),
                "points_per_second": str(spec.points_per_s), "range": str(spec.range_m), "noise_seed": str(seed),
            }  # fmt: skip


def pinhole(spec: CameraSpec) -> dict[str, str]:
    """Return the attributes of a camera, whose lens bends nothing."""
    size = {"image_size_x": str(spec.size_wh[0]), "image_size_y": str(spec.size_wh[1]), "fov": str(spec.fov_deg)}
    return {**size, "lens_circle_multiplier": "0.0", "lens_k": "0.0", "lens_kcube": "0.0"}


def weather(air: Weather) -> dict[str, float]:
    """Return CARLA's weather, whose scales have no units, for one of the city. Chosen by eye on CARLA's presets: the
    heaviest rain stands for 50 mm/h, the densest fog for a visibility of 50 m. CARLA's azimuth turns to the right.
    """
    rain = min(100.0, 2 * air.rain_mm_h)
    is_gray = air.rain_mm_h > 0 or air.visibility_m < 10_000 or (air.lux < 9_000 and air.sun_elevation_deg > 10)
    return {
        "cloudiness": 90.0 if is_gray else 10.0, "precipitation": rain, "precipitation_deposits": rain, "wetness": rain,
        "wind_intensity": 10.0, "sun_altitude_angle": air.sun_elevation_deg,
        "sun_azimuth_angle": -air.sun_azimuth_deg % 360.0,
        "fog_density": min(100.0, 5_000.0 / air.visibility_m) if air.visibility_m < 1_000 else 0.0,
        "fog_distance": 0.0, "fog_falloff": 0.1, "scattering_intensity": 1.0, "mie_scattering_scale": 0.03,
    }  # fmt: skip


def bgr(raw: Any, size_wh: tuple[int, int]) -> Array:
    """Return the pixels (H, W, 3) of an image, which CARLA sends as rows of blue, green, red, alpha."""
    return np.frombuffer(raw, np.uint8).reshape(size_wh[1], size_wh[0], 4)[:, :, :3]


def depths_m(raw: Any, size_wh: tuple[int, int]) -> Float64:
    """Return a depth image (H, W) [m], along the camera's axis: 1000 (R + 256 G + 65536 B) / (2^24 - 1)."""
    blue, green, red = np.moveaxis(bgr(raw, size_wh).astype(np.float64), 2, 0)
    found: Float64 = 1000.0 * (red + 256.0 * green + 65536.0 * blue) / (2**24 - 1)
    return found


def points(raw: Any, counts: Sequence[int]) -> tuple[Float32, Float32, Array | None]:
    """Return points (N, 3) [m], intensity (N,) and ring (N,) of a sweep: float32 x, y, z, intensity, channel after
    channel, of which `counts` has the numbers of points; the upper channel is the first. No ring where they aren't all.
    """
    rows = np.frombuffer(raw, np.float32).reshape(-1, 4)
    rings = np.repeat(np.arange(len(counts), dtype=np.uint16), counts) if sum(counts) == len(rows) else None
    return rows[:, :3] * np.array([1, -1, 1], np.float32), rows[:, 3].copy(), rings


@dataclass(frozen=True, eq=False)
class Echoes:
    """A radar's scan of N echoes in the sensor's axes."""

    xyz: Float32  # (N, 3) [m]
    radial_velocity_mps: Float32  # (N,) positive when receding
    range_m: Float32
    azimuth_rad: Float32  # Positive to the left
    altitude_rad: Float32


def echoes(raw: Any) -> Echoes:
    """Return a radar's echoes: float32 velocity, azimuth, altitude, depth, of which azimuth [rad] is positive to the
    right, and depth [m] is the distance. The server's source has the velocity positive when receding, relative to the
    radar (`ARadar::CalculateRelativeVelocity`); the client's documentation says "towards the sensor".
    """
    velocity, azimuth, altitude, depth = np.frombuffer(raw, np.float32).reshape(-1, 4).T.astype(np.float64)
    azimuth = -azimuth
    flat = depth * np.cos(altitude)
    xyz = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), depth * np.sin(altitude)], axis=1)
    return Echoes(*(np.ascontiguousarray(a, np.float32) for a in (xyz, velocity, depth, azimuth, altitude)))


_BASE_TYPES = {name: name for name in ("car", "van", "truck", "bus", "motorcycle", "bicycle")}
_TYPICAL_LWH_M = {"bicycle": (1.7, 0.6, 1.8), "motorcycle": (2.2, 0.9, 1.7)}
_USUAL_LWH_M = (4.5, 1.9, 1.6)


def label(type_id: str, attributes: Mapping[str, str]) -> str:
    """Return the class of a vehicle or walker by its blueprint's `base_type`, else by its wheels; riders count to
    their bicycles and motorcycles.
    """
    if type_id.startswith("walker."):
        return "pedestrian"
    is_small = attributes.get("number_of_wheels") == "2"
    return _BASE_TYPES.get(attributes.get("base_type", "").lower(), "motorcycle" if is_small else "car")


def box(found: Any, label: str) -> tuple[Float64, Float64]:
    """Return `actor_T_box` (4, 4) and the size (3,) [m] of an actor's bounding box, whose extent is half its size.

    Servers give two-wheelers widths of 0, and middles hundreds of meters away (CARLA's issues 3670 and 7596); such get
    the size that is usual for their class, on the ground.
    """
    size = 2 * np.array([found.extent.x, found.extent.y, found.extent.z], np.float64)
    place = position(found.location)
    if np.isfinite(size).all() and (size > 0.1).all() and (size < 30).all() and (np.abs(place) < 15).all():
        return matrix(found.location, found.rotation), size
    size = np.array(_TYPICAL_LWH_M.get(label, _USUAL_LWH_M))
    actor_T_box = np.eye(4)
    actor_T_box[2, 3] = size[2] / 2
    return actor_T_box, size


def rear_axle_m(wheels_cm: Sequence[Any], world_T_body: Float64) -> float | None:
    """Return where the rear axle is on the body's x axis [m], by the world's places of wheels [cm], front ones first;
    `None` where these can't be a vehicle's.
    """
    if len(wheels_cm) < 4:
        return None
    world = np.array([position(place) / 100 for place in wheels_cm])
    x = float(transform(inverse(world_T_body), world)[2:4, 0].mean())
    return x if -6 < x < 0 else None


_KINDS = {"Sidewalk": "sidewalk", **dict.fromkeys(
    ("Driving", "Bidirectional", "Parking", "Stop", "Shoulder", "Biking", "Entry", "Exit", "OnRamp", "OffRamp"), "road"
)}  # fmt: skip
_MAX_LANES = 20


def regions(waypoints: Iterable[Any], step_m: float) -> list[Region]:
    """Return the outlines of lanes by waypoints about `step_m` apart on their middles: those of driving lanes are
    given, and on from each to the right until there is no lane, which finds parking lanes and sidewalks.
    """
    lanes: dict[tuple[str, int, int, int], dict[float, Any]] = {}
    for waypoint in waypoints:
        lane, num = waypoint, 0
        while lane is not None and num < _MAX_LANES:
            key = (str(lane.lane_type), lane.road_id, lane.section_id, lane.lane_id)
            if round(lane.s, 2) in lanes.setdefault(key, {}):
                break
            lanes[key][round(lane.s, 2)] = lane
            lane, num = lane.get_right_lane(), num + 1
    return [
        Region(_KINDS[key[0]], _outline([found[s] for s in sorted(found)], step_m))
        for key, found in sorted(lanes.items())
        if key[0] in _KINDS
    ]


def _outline(lane: Sequence[Any], step_m: float) -> Float64:
    """Go along one edge of a lane and back along the other, to a step beyond the last waypoint; counter-clockwise."""
    frames = [matrix(waypoint.transform.location, waypoint.transform.rotation) for waypoint in lane]
    left = [world_T_lane[:2, 1] * waypoint.lane_width / 2 for world_T_lane, waypoint in zip(frames, lane, strict=True)]
    middle = [world_T_lane[:2, 3] for world_T_lane in frames]
    ahead = frames[-1][:2, 0] * (step_m if lane[-1].lane_id < 0 else -step_m)  # s falls along lanes of positive number
    middle, left = [*middle, middle[-1] + ahead], [*left, left[-1]]
    right = [m - half for m, half in zip(middle, left, strict=True)]
    edge = np.array([*right, *(m + half for m, half in zip(middle[::-1], left[::-1], strict=True))])
    kept = cv2.approxPolyDP(edge.astype(np.float32)[:, None], 0.05, True)[:, 0].astype(np.float64)
    x, y = (kept if len(kept) >= 3 else edge).T
    area = (x * np.roll(y, -1) - y * np.roll(x, -1)).sum()
    return np.stack([x, y], axis=1)[:: 1 if area > 0 else -1]
