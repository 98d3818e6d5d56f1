"""Folders in the layout of nuScenes: one of a real keyframe, one of invented scenes with known numbers."""

import hashlib
import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from fbench.replay.data.arrays import Array
from fbench.replay.data.images import encode_jpeg

TABLES = (
    "scene", "sample", "sample_data", "ego_pose", "calibrated_sensor", "sensor", "sample_annotation", "instance",
    "category", "attribute", "visibility", "log", "map",
)  # fmt: skip
STEP_US = 500_000
START_US = 1_532_402_927_000_000
RADAR_FIELDS = (
    ("x", "F", 4), ("y", "F", 4), ("z", "F", 4), ("dyn_prop", "I", 1), ("id", "I", 2), ("rcs", "F", 4), ("vx", "F", 4),
    ("vy", "F", 4), ("vx_comp", "F", 4), ("vy_comp", "F", 4), ("is_quality_valid", "I", 1), ("ambig_state", "I", 1),
    ("x_rms", "I", 1), ("y_rms", "I", 1), ("invalid_state", "I", 1), ("pdh0", "I", 1), ("vx_rms", "I", 1),
    ("vy_rms", "I", 1),
)  # fmt: skip
CATEGORIES = {
    "car": "vehicle.car", "truck": "vehicle.truck", "trailer": "vehicle.trailer", "bus": "vehicle.bus.rigid",
    "construction_vehicle": "vehicle.construction", "bicycle": "vehicle.bicycle", "motorcycle": "vehicle.motorcycle",
    "pedestrian": "human.pedestrian.adult", "traffic_cone": "movable_object.trafficcone",
    "barrier": "movable_object.barrier", "": "movable_object.debris",
}  # fmt: skip


def token(*names: object) -> str:
    """A token as the set's: 32 hexadecimal digits."""
    return hashlib.md5("/".join(map(str, names)).encode(), usedforsecurity=False).hexdigest()


@dataclass
class Tables:
    """Rows by table, written into a folder as the set's are."""

    root: Path
    version: str = "v1.0-mini"
    rows: dict[str, list[dict[str, Any]]] = field(default_factory=lambda: {name: [] for name in TABLES})

    def add(self, table: str, token: str, **values: object) -> str:
        self.rows[table].append({"token": token, **values})
        return token

    def row(self, table: str, **values: object) -> dict[str, Any]:
        """The first row that has these values."""
        return next(row for row in self.rows[table] if all(row[key] == value for key, value in values.items()))

    def write(self) -> Path:
        folder = self.root / self.version
        folder.mkdir(parents=True, exist_ok=True)
        for name, rows in self.rows.items():
            (folder / f"{name}.json").write_text(json.dumps(rows, indent=0))
        return self.root

    def file(self, name: str, data: bytes) -> str:
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        return name

    def sensor(self, channel: str, modality: str, translation: Array, wxyz: Array, intrinsic: object = ()) -> None:
        self.add("sensor", token("sensor", channel), channel=channel, modality=modality)
        self.add(
            "calibrated_sensor", token("calibration", channel), sensor_token=token("sensor", channel),
            translation=list(translation), rotation=list(wxyz), camera_intrinsic=np.asarray(intrinsic).tolist(),
        )  # fmt: skip

    def link(self, table: str, tokens: list[str]) -> None:
        """Chain rows by prev and next."""
        by_token = {row["token"]: row for row in self.rows[table]}
        for before, after in zip(["", *tokens], [*tokens, ""], strict=True):
            if before:
                by_token[before]["next"] = after
            if after:
                by_token[after]["prev"] = before

    def scene(self, name: str, sample_stamps_us: list[int], log: str = "log") -> list[str]:
        """Add a scene and its samples; returns their tokens."""
        tokens = [token(name, "sample", i) for i in range(len(sample_stamps_us))]
        for own, stamp_us in zip(tokens, sample_stamps_us, strict=True):
            self.add("sample", own, timestamp=stamp_us, scene_token=token("scene", name), prev="", next="")
        self.link("sample", tokens)
        self.add(
            "scene", token("scene", name), name=name, description=f"What {name} shows", log_token=token(log),
            nbr_samples=len(tokens), first_sample_token=tokens[0], last_sample_token=tokens[-1],
        )  # fmt: skip
        return tokens

    def data(
        self, name: str, channel: str, stamp_us: int, sample: str, data: bytes, is_key: bool = True, pose: str = "",
        size_wh: tuple[int, int] | None = None,
    ) -> str:  # fmt: skip
        """Add what a sensor measured, at a pose that is there already."""
        suffix = {"CAM": ".jpg", "LID": ".pcd.bin", "RAD": ".pcd"}[channel[:3]]
        file = f"{'samples' if is_key else 'sweeps'}/{channel}/{name}__{channel}__{stamp_us}{suffix}"
        self.file(file, data)
        width, height = size_wh or ("", "")
        return self.add(
            "sample_data", token(name, channel, stamp_us), sample_token=sample, ego_pose_token=pose,
            calibrated_sensor_token=token("calibration", channel), timestamp=stamp_us, fileformat=suffix[1:],
            is_key_frame=is_key, height=height, width=width, filename=file, prev="", next="",
        )  # fmt: skip

    def pose(self, name: str, stamp_us: int, translation: Array, wxyz: Array, own: str = "") -> str:
        return self.add(
            "ego_pose", own or token(name, "pose", stamp_us), timestamp=stamp_us, translation=list(translation),
            rotation=list(wxyz),
        )  # fmt: skip

    def fixed(self) -> None:
        """Add the tables that are the same everywhere."""
        self.add(
            "log", token("log"), logfile="n015-2018-07-24-11-22-45+0800", vehicle="n015", date_captured="2018-07-24",
            location="singapore-onenorth",
        )  # fmt: skip
        for number, level in enumerate(["v0-40", "v40-60", "v60-80", "v80-100"], 1):
            self.add("visibility", str(number), level=level, description="")
        for name in ("vehicle.moving", "vehicle.parked", "pedestrian.standing"):
            self.add("attribute", token("attribute", name), name=name, description="")


def pcd(rows: list[dict[str, float]], fields=RADAR_FIELDS, num: int | None = None, form: str = "binary") -> bytes:
    """A radar file as the set's; fields that rows lack are 0, flags those of a good echo."""
    good = {"ambig_state": 3}
    num = len(rows) if num is None else num
    lines = [
        "# .PCD v0.7 - Point Cloud Data file format", "VERSION 0.7", f"FIELDS {' '.join(f[0] for f in fields)}",
        f"SIZE {' '.join(str(f[2]) for f in fields)}", f"TYPE {' '.join(f[1] for f in fields)}",
        f"COUNT {' '.join('1' for _ in fields)}", f"WIDTH {num}", "HEIGHT 1", "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {num}", f"DATA {form}",
    ]  # fmt: skip
    codes = {("F", 4): "f", ("F", 8): "d", ("I", 1): "b", ("I", 2): "h", ("I", 4): "i"}
    body = b"".join(
        struct.pack("<" + codes[kind, size], (float if kind == "F" else int)(row.get(name, good.get(name, 0))))
        for row in rows
        for name, kind, size in fields
    )
    return ("\n".join(lines) + "\n").encode() + body + b"\n"


def wxyz(rotation: Rotation) -> list[float]:
    x, y, z, w = rotation.as_quat(canonical=True)
    return [w, x, y, z]


@dataclass(frozen=True)
class RealFrame:
    """The real keyframe, by a plain reading of its file."""

    folder: Path
    content: dict[str, Any]

    @property
    def instances(self) -> list[dict[str, Any]]:
        return self.content["instances"]

    @property
    def boxes(self) -> Array:
        """(N, 7) x, y, z, l, w, h, yaw in the LiDAR's coordinates, z in the middle."""
        return np.array([instance["bbox_3d"] for instance in self.instances])

    @property
    def cloud(self) -> Array:
        """(N, 5) x, y, z, intensity, ring."""
        path = self.folder / self.content["lidar_points"]["lidar_path"]
        return np.fromfile(path, "<f4").reshape(-1, 5)

    @property
    def ego_T_lidar(self) -> Array:
        return rigid(self.content["lidar_points"]["lidar2ego"])

    @property
    def world_T_ego(self) -> Array:
        return rigid(self.content["ego2global"])

    @property
    def world_yaw(self) -> Array:
        """(N,) headings of boxes that stand upright in the world and have the file's yaw in the LiDAR's x-y plane.

        The set's boxes are upright in the world. The file's have lost the tilt of the LiDAR and of the vehicle: only
        the yaw in the LiDAR's coordinates was kept.
        """
        world_R_lidar = (self.world_T_ego @ self.ego_T_lidar)[:3, :3]

        def heading(yaw: float) -> float:
            tilted = world_R_lidar @ [np.cos(yaw), np.sin(yaw), 0]
            guess = np.arctan2(tilted[1], tilted[0])

            def surplus(angle: float) -> float:
                flat = world_R_lidar.T @ [np.cos(angle), np.sin(angle), 0]
                return (np.arctan2(flat[1], flat[0]) - yaw + np.pi) % (2 * np.pi) - np.pi

            return brentq(surplus, guess - 0.1, guess + 0.1, xtol=1e-15)

        return np.array([heading(yaw) for yaw in self.boxes[:, 6]])


def rigid(matrix: list[list[float]]) -> Array:
    """The rigid transform nearest to one that was rounded to float32."""
    result = np.array(matrix)
    result[:3, :3] = Rotation.from_matrix(result[:3, :3]).as_matrix()
    return result


@pytest.fixture(scope="session")
def real_frame(shared: Path) -> RealFrame:
    folder = shared / "data/nuscenes_frame"
    if not folder.is_dir():
        pytest.skip(f"no real keyframe at {folder}")
    return RealFrame(folder, json.loads((folder / "frame.json").read_text()))


def wrap(frame: RealFrame, root: Path, neighbors: bool) -> Tables:
    """Put the real keyframe into the set's layout: one scene, and one sample, or three where there are `neighbors`.

    Neighbors have the same sweep half a second before and after, and the boxes where their velocity puts them.
    """
    tables = Tables(root)
    tables.fixed()
    content = frame.content
    key_us = round(content["timestamp"] * 1e6)
    names = ["before", "key", "after"] if neighbors else ["key"]
    stamps_us = [key_us + STEP_US * i for i in ((-1, 0, 1) if neighbors else (0,))]
    samples = tables.scene("scene-0061", stamps_us)
    key = samples[names.index("key")]
    world_T_ego = frame.world_T_ego
    at = world_T_ego[:3, 3], wxyz(Rotation.from_matrix(world_T_ego[:3, :3]))
    tables.sensor("LIDAR_TOP", "lidar", frame.ego_T_lidar[:3, 3], wxyz(Rotation.from_matrix(frame.ego_T_lidar[:3, :3])))
    sweep = (frame.folder / content["lidar_points"]["lidar_path"]).read_bytes()
    for sample, stamp_us in zip(samples, stamps_us, strict=True):
        pose = tables.pose("LIDAR_TOP", stamp_us, *at)
        tables.data("n015", "LIDAR_TOP", stamp_us, sample, sweep, pose=pose)
    for channel, camera in content["images"].items():
        ego_T_camera = rigid(camera["cam2ego"])
        rotation = wxyz(Rotation.from_matrix(ego_T_camera[:3, :3]))
        tables.sensor(channel, "camera", ego_T_camera[:3, 3], rotation, camera["cam2img"])
        stamp_us = round(camera["timestamp"] * 1e6)
        picture = (frame.folder / camera["img_path"]).read_bytes()
        # The file's way from LiDAR to camera leads through the world: it tells where the vehicle was at the image.
        world_T_camera = world_T_ego @ frame.ego_T_lidar @ np.linalg.inv(rigid(camera["lidar2cam"]))
        there = world_T_camera @ np.linalg.inv(ego_T_camera)
        pose = tables.pose(channel, stamp_us, there[:3, 3], wxyz(Rotation.from_matrix(there[:3, :3])))
        tables.data("n015", channel, stamp_us, key, picture, pose=pose, size_wh=(1600, 900))
    _add_boxes(tables, frame, dict(zip(names, samples, strict=True)))
    tables.write()
    return tables


def _add_boxes(tables: Tables, frame: RealFrame, samples: dict[str, str]) -> None:
    names = {number: name for name, number in frame.content["categories"].items()}
    for name in CATEGORIES.values():
        tables.add("category", token("category", name), name=name, description="")
    world_T_lidar = frame.world_T_ego @ frame.ego_T_lidar
    steps_s = {"before": -0.5, "key": 0.0, "after": 0.5}
    for i, (instance, box, yaw) in enumerate(zip(frame.instances, frame.boxes, frame.world_yaw, strict=True)):
        category = CATEGORIES[names.get(instance["bbox_label"], "")]
        own = tables.add("instance", token("instance", i), category_token=token("category", category))
        center = world_T_lidar[:3, :3] @ box[:3] + world_T_lidar[:3, 3]
        velocity = world_T_lidar[:3, :3] @ [*instance["velocity"], 0.0]
        here = samples if np.isfinite(velocity).all() else {"key": samples["key"]}
        tokens = [
            tables.add(
                "sample_annotation", token("box", i, when), sample_token=sample, instance_token=own,
                attribute_tokens=[], visibility_token=str(1 + i % 4),
                translation=(center + np.nan_to_num(velocity) * steps_s[when]).tolist(),
                size=[box[4], box[3], box[5]], rotation=wxyz(Rotation.from_euler("z", yaw)),
                num_lidar_pts=instance["num_lidar_pts"], num_radar_pts=instance["num_radar_pts"], prev="", next="",
            )
            for when, sample in here.items()
        ]  # fmt: skip
        tables.link("sample_annotation", tokens)


@pytest.fixture(scope="session")
def real_tables(real_frame: RealFrame, tmp_path_factory: pytest.TempPathFactory) -> Tables:
    """The real keyframe in the set's layout: one scene with one sample."""
    return wrap(real_frame, tmp_path_factory.mktemp("real") / "nuscenes", neighbors=False)


@pytest.fixture(scope="session")
def real_neighbors(real_frame: RealFrame, tmp_path_factory: pytest.TempPathFactory) -> Tables:
    """The same with an invented sample before and after it, from which velocities come."""
    return wrap(real_frame, tmp_path_factory.mktemp("real3") / "nuscenes", neighbors=True)


SCENE_S = (0.0, 0.5, 1.0, 1.5, 3.2, 5.0)
"""When the samples of the first invented scene are [s]."""
SECOND_S = (60.0, 60.5)
OFFSETS_US = {"CAM_FRONT": -30_000, "LIDAR_TOP": 0, "RADAR_FRONT": -20_000}
"""How much later than the sample each sensor's keyframe is."""
SWEEP_US = 250_000
"""How much later a sweep follows."""
ECHOES = [
    {"x": 10.0, "y": 0.0, "vx": -5.0, "vy": 1.0, "rcs": 7.5, "vx_comp": 0.5, "vy_comp": 9.0, "dyn_prop": 1},
    {"x": 3.0, "y": 4.0, "vx": 1.0, "vy": 2.0, "rcs": -2.0, "dyn_prop": 6},
    {"x": 0.0, "y": -8.0, "vx": 3.0, "vy": -4.0, "rcs": 0.0},
    {"x": 1.0, "y": 1.0, "dyn_prop": 7},
    {"x": 2.0, "y": 1.0, "invalid_state": 4},
    {"x": 3.0, "y": 1.0, "ambig_state": 2},
]
"""The filter keeps the first three."""
POSES = {i: Rotation.from_euler("ZYX", [90, 0, 0] if i != 2 else [90, 2, 1], degrees=True) for i in range(6)}
"""World from body at the samples; the position is (100 + i, 200, 0)."""
TRACKS = {
    "A": ("vehicle.car", {0: 100.0, 1: 101.0, 2: 103.0, 3: 106.0}),
    "B": ("human.pedestrian.adult", {3: 110.0, 4: 111.0}),
    "C": ("vehicle.bus.bendy", {3: 120.0, 4: 121.0, 5: 122.0}),
    "D": ("static_object.bicycle_rack", {2: 130.0, 3: 131.0, 4: 134.4}),
    "E": ("spaceship", {5: 140.0}),
}
"""Category and world x [m] by sample of the boxes in the first invented scene; y is 210, z 1."""


def scenes(root: Path) -> Tables:
    """Two invented scenes with a camera, a LiDAR and a radar, sweeps between the samples, and boxes in the first."""
    tables = Tables(root)
    tables.fixed()
    tables.sensor("LIDAR_TOP", "lidar", [1, 2, 3], wxyz(Rotation.from_euler("z", -90, degrees=True)))
    tables.sensor("RADAR_FRONT", "radar", [3, 0, 0.5], [1, 0, 0, 0])
    tables.sensor("CAM_FRONT", "camera", [1.5, 0, 1.5], [0.5, -0.5, 0.5, -0.5], [[8, 0, 4], [0, 9, 3], [0, 0, 1]])
    for name, times_s in (("scene-0001", SCENE_S), ("scene-0002", SECOND_S)):
        stamps_us = [START_US + round(1e6 * s) for s in times_s]
        for i, (sample, stamp_us) in enumerate(zip(tables.scene(name, stamps_us), stamps_us, strict=True)):
            for channel in OFFSETS_US:
                _measure(tables, name, channel, i, sample, stamp_us)
    _measure(tables, "scene-0001", "LIDAR_TOP", 0, token("scene-0001", "sample", 0), START_US - 300_000, keys=(False,))
    for category in sorted({category for category, _ in TRACKS.values()}):
        tables.add("category", token("category", category), name=category, description="")
    for name, (category, places) in TRACKS.items():
        _track(tables, name, category, places)
    tables.write()
    return tables


def _measure(
    tables: Tables, scene: str, channel: str, i: int, sample: str, stamp_us: int, keys: tuple[bool, ...] = (True, False)
) -> None:
    picture = encode_jpeg(np.full((6, 8, 3), 40 * i, np.uint8))
    cloud = np.array([[1 + i, 2, 3, 100, 7], [4, 5, 6, 255, 31]], "<f4").tobytes()
    content = {"CAM_FRONT": picture, "LIDAR_TOP": cloud, "RADAR_FRONT": pcd(ECHOES)}[channel]
    for is_key in keys:
        own_us = stamp_us + OFFSETS_US[channel] + (0 if is_key else SWEEP_US)
        pose = tables.pose(f"{scene}/{channel}", own_us, [100 + i, 200, 0], wxyz(POSES[i]))
        size_wh = (8, 6) if channel == "CAM_FRONT" else None
        tables.data(scene, channel, own_us, sample, content, is_key, pose, size_wh)


def _track(tables: Tables, name: str, category: str, places: dict[int, float]) -> None:
    own = tables.add("instance", token("instance", name), category_token=token("category", category))
    attributes = {"A": ["vehicle.moving"], "B": ["pedestrian.standing"], "C": ["vehicle.moving", "vehicle.parked"]}
    tokens = [
        tables.add(
            "sample_annotation", token("box", name, i), sample_token=token("scene-0001", "sample", i),
            instance_token=own, attribute_tokens=[token("attribute", text) for text in attributes.get(name, [])],
            visibility_token={"A": "1", "B": "2", "C": "3", "D": "4", "E": ""}[name], translation=[x, 210.0, 1.0],
            size=[1.9, 4.5, 1.6], rotation=wxyz(Rotation.from_euler("z", 120, degrees=True)), num_lidar_pts=i,
            num_radar_pts=2 * i, prev="", next="",
        )
        for i, x in places.items()
    ]  # fmt: skip
    tables.link("sample_annotation", tokens)


@pytest.fixture
def nuscenes(tmp_path: Path) -> Tables:
    """The invented scenes, for tests that change them."""
    return scenes(tmp_path / "nuscenes")
