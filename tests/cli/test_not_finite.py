"""Numbers that are none, wherever they come in: a fault, or an error of one line; never a silent result."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cli.conftest import FORWARD, UPRIGHT, messages, rig, truths, write_log

from fbench.replay.data.messages import Pose, RadarScan, Truth
from fbench.replay.data.rig import Mount

NAN, INF, HUGE = np.nan, np.inf, 1e200
S = 1_000_000_000
K = np.array([[60.0, 0, 39.5], [0, 60, 29.5], [0, 0, 1]])


def change(items, kind, **fields):
    return [replace(m, **fields) if isinstance(m, kind) and m.stamp_ns == S else m for m in items]


def counts(folder):
    rows = json.loads((folder / "faults.json").read_text())["rows"]
    return {row["code"]: row["count"] for row in rows if row["count"]}


def replay(fbench, tmp_path, items, log_rig=None, pipeline="lidar3d"):
    log = write_log(tmp_path / "log.mcap", items, log_rig)
    result = fbench("replay", log, "-p", pipeline, "-o", "run", "--all-around")
    return result, log


@pytest.mark.parametrize("value", [NAN, INF, -INF, HUGE])
@pytest.mark.parametrize("field", ["translation_m", "rotation_xyzw"])
def test_poses(fbench, tmp_path, field, value):
    good = {"translation_m": np.zeros(3), "rotation_xyzw": UPRIGHT}
    bad = {**good, field: np.append(good[field][:-1], value)}
    poses = [Pose("gnss", m.stamp_ns, m.stamp_ns, **(bad if m.stamp_ns == S else good)) for m in truths()]
    result, log = replay(fbench, tmp_path, [*messages(), *truths(), *poses])
    assert (result.code, counts(tmp_path / "run")) == (4, {"DAT005": 1})
    assert fbench("log", "check", log).code == 1


@pytest.mark.parametrize("sensor", ["lidar", "radar", "camera"])
@pytest.mark.parametrize(
    ("translation", "rotation"),
    [((NAN, 0, 0), UPRIGHT), ((0, INF, 0), UPRIGHT), ((0, 0, HUGE), UPRIGHT), ((0, 0, 0), np.zeros(4)),
     ((0, 0, 0), np.full(4, NAN)), ((0, 0, 0), np.array([0, 0, 0, INF])), ((0, 0, 0), np.full(4, HUGE))],
)  # fmt: skip
def test_mounts(fbench, tmp_path, sensor, translation, rotation):
    whole = rig()
    mount = Mount(whole.mounts[sensor].kind, np.array(translation, float), rotation)
    result, log = replay(
        fbench, tmp_path, [*messages(), *truths()], replace(whole, mounts={**whole.mounts, sensor: mount})
    )
    assert result.code == 3
    assert result.err.endswith("[CAL001]\n")
    assert result.err.count("\n") == 1
    assert fbench("log", "check", log).code == 1


@pytest.mark.parametrize(
    ("entry", "value"),
    [((0, 0), NAN), ((0, 0), 0.0), ((0, 0), -60.0), ((0, 0), HUGE), ((1, 1), INF), ((1, 1), 0.0), ((0, 2), NAN),
     ((1, 2), -INF), ("distortion", NAN), ("distortion", INF), ("distortion", HUGE)],
)  # fmt: skip
def test_cameras(fbench, tmp_path, entry, value):
    whole, matrix, coefficients = rig(), K.copy(), np.zeros(5)
    if entry == "distortion":
        coefficients[0] = value
    else:
        matrix[entry] = value
    camera = replace(whole.cameras["camera"], K=matrix, distortion=coefficients, distortion_model="plumb_bob")
    result, log = replay(fbench, tmp_path, [*messages(), *truths()], replace(whole, cameras={"camera": camera}))
    assert result.code == 3
    assert result.err.endswith("[CAL001]\n")
    assert fbench("log", "check", log).code == 1


BAD_BOXES = [
    {"center_m": np.array([[NAN, 0, 0]])}, {"center_m": np.array([[0, INF, 0]])},
    {"center_m": np.array([[HUGE, 0, 0]])}, {"size_lwh_m": np.zeros((1, 3))}, {"size_lwh_m": -np.ones((1, 3))},
    {"size_lwh_m": np.full((1, 3), NAN)}, {"yaw_rad": np.array([NAN])}, {"yaw_rad": np.array([INF])},
    {"roll_rad": np.array([NAN])}, {"velocity_mps": np.full((1, 3), INF)},
    {"velocity_mps": np.array([[0, -INF, 0]])},
]  # fmt: skip


@pytest.mark.parametrize("fields", BAD_BOXES, ids=lambda fields: next(iter(fields)))
def test_truth(fbench, tmp_path, fields):
    items = [*messages(), *truths()]
    box = next(m for m in items if isinstance(m, Truth)).boxes3d
    result, log = replay(fbench, tmp_path, change(items, Truth, boxes3d=replace(box, **fields)))
    assert (result.code, counts(tmp_path / "run")) == (4, {"GT004": 1})
    assert fbench("log", "check", log).code == 1


@pytest.mark.parametrize("field", ["radial_velocity_mps", "rcs_dbsm"])
@pytest.mark.parametrize("value", [INF, -INF, 1e30])
def test_echoes(fbench, tmp_path, field, value):
    good = [*messages(), *truths()]
    unknown = change(good, RadarScan, **{field: np.full(4, NAN, np.float32)})
    assert replay(fbench, tmp_path, unknown, pipeline="radar3d")[0].code == 0
    assert not counts(tmp_path / "run")
    expected = (tmp_path / "run" / "tracks.parquet").read_bytes()
    Path("run").rename("unknown")
    result, _ = replay(
        fbench, tmp_path, change(good, RadarScan, **{field: np.full(4, value, np.float32)}), pipeline="radar3d"
    )
    assert (result.code, counts(tmp_path / "run")) == (0, {"DAT006": 1})
    assert (tmp_path / "run" / "tracks.parquet").read_bytes() == expected  # as if it weren't measured


PLUGIN = """
import numpy as np
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.frames import Output
nan, inf = np.nan, np.inf


class Mine:
    def start(self, rig, log_info):
        pass

    def reset(self, reason):
        pass

    def step(self, frame):
        return Output({boxes}, None, {{}})
"""
SOLID = {
    "center_m": "np.zeros((1, 3))",
    "size_lwh_m": "np.ones((1, 3))",
    "yaw_rad": "np.zeros(1)",
    "score": "np.ones(1)",
}
FLAT = {"camera": "np.array(['camera'])", "xyxy_px": "np.array([[0., 0, 9, 9]])", "score": "np.ones(1)"}


@pytest.mark.parametrize(
    ("kind", "field", "value"),
    [("Boxes3D", "center_m", "np.full((1, 3), nan)"), ("Boxes3D", "size_lwh_m", "np.full((1, 3), inf)"),
     ("Boxes3D", "yaw_rad", "np.array([nan])"), ("Boxes3D", "score", "np.array([inf])"),
     ("Boxes3D", "velocity_mps", "np.full((1, 3), inf)"), ("Boxes2D", "xyxy_px", "np.full((1, 4), nan)"),
     ("Boxes2D", "score", "np.array([nan])"), ("Boxes2D", "distance_m", "np.array([inf])"),
     ("Boxes2D", "range_rate_mps", "np.array([-inf])")],
)  # fmt: skip
def test_results_of_a_plugin(fbench, log, tmp_path, kind, field, value):
    fields = {**(SOLID if kind == "Boxes3D" else FLAT), field: value}
    boxes = f"{kind}({', '.join(f'{name}={text}' for name, text in fields.items())})"
    Path("mine.py").write_text(PLUGIN.format(boxes=boxes))
    assert fbench("replay", log, "-p", "mine.py:Mine", "-o", "run").code == 4
    assert counts(tmp_path / "run") == {"PRD001": 6}


@pytest.mark.slow
def test_previews(fbench, tmp_path):
    whole, items = rig(), [*messages(), *truths()]
    nowhere = replace(whole, mounts={**whole.mounts, "lidar": Mount("lidar", np.zeros(3), np.zeros(4))})
    lens = replace(whole, cameras={"camera": replace(whole.cameras["camera"], K=K * NAN)})
    lost = [Pose("gnss", m.stamp_ns, m.stamp_ns, np.full(3, NAN), np.zeros(4)) for m in truths()]
    box = next(m for m in items if isinstance(m, Truth)).boxes3d
    boxes = change(items, Truth, boxes3d=replace(box, center_m=np.full((1, 3), INF)))
    logs = {
        "nowhere": (items, nowhere),
        "lens": (items, lens),
        "lost": ([*items, *lost], whole),
        "boxes": (boxes, whole),
    }
    for name, (content, of) in logs.items():
        log = write_log(tmp_path / f"{name}.mcap", content, of)
        assert fbench("log", "preview", log, "-o", f"preview-{name}").code == 0


def test_a_stereo_pair_in_one_place_is_none(fbench, tmp_path):
    whole = rig()
    twin = {"right": Mount("camera", whole.mounts["camera"].translation_m, FORWARD)}
    pair = replace(whole, mounts={**whole.mounts, **twin}, cameras={**whole.cameras, "right": whole.cameras["camera"]})
    both = [
        m for item in messages() for m in ([item, replace(item, sensor="right")] if item.sensor == "camera" else [item])
    ]
    log = write_log(tmp_path / "log.mcap", both, pair)
    result = fbench("replay", log, "-p", "stereo3d", "-o", "run")
    assert (result.code, result.err.count("\n")) == (3, 1)
    assert "a stereo pair needs two cameras" in result.err
