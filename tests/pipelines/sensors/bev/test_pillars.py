"""Networks in two files, as Autoware has them: random weights, and another decoder that goes point by point."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cuda import needs_cuda

from fbench.pipelines.sensors.bev.detector import BUILTIN, BevParams, open_detector
from fbench.pipelines.sensors.bev.grid import NO_LIDAR, NO_RADAR, BevPoints
from fbench.pipelines.sensors.bev.pillars import PillarLayout, decode, group_points, read_layout
from fbench.pipelines.sensors.points.ground import Plane
from fbench.pipelines.variants.learned3d import Learned3D, Learned3DParams
from fbench.replay.contracts.devices import use_device
from fbench.replay.contracts.errors import ConfigError, ModelError

onnx = pytest.importorskip("onnx", reason="onnx, which comes with the extra torch, isn't installed")
from onnx import TensorProto, helper, numpy_helper  # noqa: E402

pytestmark = pytest.mark.torch

OUTPUTS = {"heatmap": 5, "reg": 2, "height": 1, "dim": 3, "rot": 2, "vel": 2}
SIDE, CELL_M, REACH_M, POINTS = 32, 0.5, 8.0, 8
YAML = f"""\
/**:
  ros__parameters:
    model_params:
      class_names: ["CAR", "TRUCK", "BUS", "BICYCLE", "PEDESTRIAN"]
      point_cloud_range: [{-REACH_M}, {-REACH_M}, -2.0, {REACH_M}, {REACH_M}, 4.0]
      voxel_size: [{CELL_M}, {CELL_M}, 6.0]
      downsample_factor: 1
      encoder_in_feature_size: 9
      has_twist: true
"""
FLAT = Plane(0.0, 0.0, 0.0)


def save(path: Path, nodes, inputs, outputs, weights: dict[str, np.ndarray]) -> None:
    ports = [
        [helper.make_tensor_value_info(n, TensorProto.FLOAT, shape) for n, shape in group]
        for group in (inputs, outputs)
    ]
    graph = helper.make_graph(nodes, "made", *ports, [numpy_helper.from_array(v, n) for n, v in weights.items()])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.save(model, path)


def make_files(folder: Path, names: bool = True, num: int | str = "num", features: int = 9) -> dict[str, np.ndarray]:
    """Write encoder, head, and their parameters; return the weights. More channels leave the first as they are."""
    draw = np.random.default_rng(5)
    weights = {"w": draw.normal(0, 0.3, (features, 32)).astype(np.float32)}
    nodes = [helper.make_node("MatMul", ["input_features", "w"], ["x"]), helper.make_node("Relu", ["x"], ["y"]),
             helper.make_node("ReduceMax", ["y"], ["pillar_features"], axes=[1], keepdims=1)]  # fmt: skip
    save(folder / "pts_voxel_encoder.onnx", nodes, [("input_features", (num, POINTS, features))],
         [("pillar_features", (num, 1, 32))], weights)  # fmt: skip
    heads = {
        name: np.random.default_rng(i).normal(0, 0.01 if i == 0 else 0.1, (size, 32, 3, 3)).astype(np.float32)
        for i, (name, size) in enumerate(OUTPUTS.items())
    }
    called = {name: name if names else f"out{i}" for i, name in enumerate(OUTPUTS)}
    nodes = [helper.make_node("Conv", ["spatial_features", f"w_{n}"], [called[n]], pads=[1] * 4) for n in OUTPUTS]
    outputs = [(called[n], (1, size, SIDE, SIDE)) for n, size in OUTPUTS.items()]
    inputs = [("spatial_features", (1, 32, SIDE, SIDE))]
    save(folder / "pts_backbone_neck_head.onnx", nodes, inputs, outputs, {f"w_{n}": w for n, w in heads.items()})
    (folder / "centerpoint_ml_package.param.yaml").write_text(YAML)
    return {**weights, **heads}


def params(folder: Path, **more) -> BevParams:
    files = {"weights": "pts_backbone_neck_head.onnx", "encoder": "pts_voxel_encoder.onnx"}
    named = {**{name: folder / file for name, file in files.items()}, **more}
    return BevParams(threads=1, **{"layout": folder / "centerpoint_ml_package.param.yaml", **named})


def detect_plainly(points: np.ndarray, weights: dict[str, np.ndarray], least: float) -> list[tuple[Any, ...]]:
    """Boxes before any gives way to another: score, label, x, y, z, length, width, height, yaw, speed along x, y."""
    pillars: dict[tuple[int, int], list[tuple[float, float, float]]] = {}
    for x, y, z in sorted(map(tuple, points.tolist())):
        if -REACH_M <= x < REACH_M and -REACH_M <= y < REACH_M and -2 <= z < 4:
            pillars.setdefault((math.floor((y + REACH_M) / CELL_M), math.floor((x + REACH_M) / CELL_M)), []).append(
                (x, y, z)
            )
    image = np.zeros((32, SIDE + 2, SIDE + 2))
    for (row, column), members in pillars.items():
        kept = members[:POINTS]
        mean = np.mean(kept, axis=0)
        middle = (-REACH_M + (column + 0.5) * CELL_M, -REACH_M + (row + 0.5) * CELL_M)
        rows = [[*p, 0.0, *(np.array(p) - mean), p[0] - middle[0], p[1] - middle[1]] for p in kept]
        rows += [[0.0] * 9] * (POINTS - len(rows))
        image[:, row + 1, column + 1] = np.maximum(np.array(rows) @ weights["w"], 0).max(axis=0)
    boxes = []
    for row in range(SIDE):
        for column in range(SIDE):
            patch = image[:, row : row + 3, column : column + 3]
            out = {name: (weights[name] * patch).sum(axis=(1, 2, 3)) for name in OUTPUTS}
            kind = int(out["heatmap"].argmax())
            score = 1 / (1 + math.exp(-out["heatmap"][kind]))
            sin, cos = out["rot"]
            if score < least or (kind != 4 and math.hypot(sin, cos) < 0.3):
                continue
            x, y = -REACH_M + CELL_M * (column + out["reg"][0]), -REACH_M + CELL_M * (row + out["reg"][1])
            width, length, height = (math.exp(min(max(v, -3.2), 3.2)) for v in out["dim"])
            yaw = (-math.atan2(sin, cos) - math.pi / 2 + math.pi) % (2 * math.pi) - math.pi
            label = ("car", "truck", "bus", "bicycle", "pedestrian")[kind]
            boxes.append((score, label, x, y, float(out["height"][0]), length, width, height, yaw, *out["vel"]))
    return sorted(boxes, key=lambda box: -box[0])


@pytest.mark.parametrize(("names", "num"), [(True, "num"), (False, "num"), (True, 700)])
def test_boxes_are_those_of_another_decoder(tmp_path, names, num):
    weights = make_files(tmp_path, names, num)
    points = np.random.default_rng(8).uniform([-9, -9, -3], [9, 9, 5], (900, 3)).astype(np.float32)
    points = np.concatenate([points, np.float32([[1.1, 1.1, 0.5]]) + points[:40] / 100])  # more than a pillar holds
    found = open_detector(params(tmp_path)).detect(BevPoints(points, NO_RADAR), FLAT, 0.55)
    every = detect_plainly(points, weights, 0.55)
    apart: list[tuple[Any, ...]] = []
    for box in every:  # the surest first; nearer than 0.5 m, it gives way
        if all(math.dist(box[2:4], other[2:4]) >= 0.5 for other in apart):
            apart.append(box)
    assert 20 < len(found) <= len(apart) < len(every)
    for i in range(len(found)):
        distance_m = [math.dist(box[2:4], found.center_m[i, :2]) for box in apart]
        score, label, *expected = apart[int(np.argmin(distance_m))]
        assert (found.label[i], float(found.score[i])) == (label, pytest.approx(score, abs=1e-4))
        ours = [*found.center_m[i], *found.size_lwh_m[i], found.yaw_rad[i], *found.velocity_mps[i, :2]]
        np.testing.assert_allclose(ours, expected, rtol=2e-4, atol=2e-4)
    assert (np.diff(found.score) <= 0).all()


@needs_cuda
def test_cuda_finds_what_the_cpu_finds(tmp_path):
    make_files(tmp_path)
    points = BevPoints(np.random.default_rng(8).uniform([-9, -9, -1], [9, 9, 4], (900, 3)).astype(np.float32), NO_RADAR)
    found = open_detector(params(tmp_path)).detect(points, FLAT, 0.55)
    with use_device("cuda"):
        others = open_detector(params(tmp_path)).detect(points, FLAT, 0.55)
    assert found.label.tolist() == others.label.tolist()
    for name, values in found.arrays().items():
        if values.dtype.kind == "f":
            np.testing.assert_allclose(getattr(others, name), values, rtol=1e-3, atol=1e-3)


def test_order_of_points_doesnt_matter_and_heights_are_above_ground(tmp_path):
    make_files(tmp_path)
    points = np.random.default_rng(8).uniform([-8, -8, -1], [8, 8, 3], (2000, 3)).astype(np.float32)
    detector = open_detector(params(tmp_path))
    flat, again, raised = (
        detector.detect(BevPoints(p, NO_RADAR), plane, 0.6)
        for p, plane in ((points, FLAT), (points[::-1], FLAT), (points, Plane(0.0, 0.0, 2.0)))
    )
    for name, values in flat.arrays().items():
        np.testing.assert_array_equal(values, getattr(again, name))
    np.testing.assert_allclose(raised.center_m[:, 2] - flat.center_m[:, 2], 2.0)
    cars = open_detector(params(tmp_path, classes=("car",))).detect(BevPoints(points, NO_RADAR), FLAT, 0.6)
    np.testing.assert_array_equal(cars.score, flat.score[flat.label == "car"])
    detector.detect(BevPoints(NO_LIDAR, NO_RADAR), FLAT, 0.6)  # no pillar at all


def test_a_pipeline_takes_lidars_alone(tmp_path):
    make_files(tmp_path)
    assert Learned3D(Learned3DParams(params(tmp_path))).kinds == ("lidar",)
    assert Learned3D().kinds == ("lidar", "radar")


def test_features_by_hand():
    layout = PillarLayout(low_m=(-2.0, -2.0, 0.0), high_m=(2.0, 2.0, 4.0), cell_m=(0.5, 0.5, 4.0))
    points = np.array([[0.1, -0.3, 1.0], [0.4, -0.1, 2.0], [9, 0, 1]], np.float32)
    features, cell = group_points(points, layout, 3, 10)
    assert cell.tolist() == [3 * 8 + 4]
    expected = [
        [0.1, -0.3, 1, 0, -0.15, -0.1, -0.5, -0.15, -0.05, -1],
        [0.4, -0.1, 2, 0, 0.15, 0.1, 0.5, 0.15, 0.15, 0],
        [0] * 10,
    ]
    np.testing.assert_allclose(features[0], expected, atol=1e-6)


def test_a_box_by_hand():
    outputs = [np.zeros((1, size, 8, 8)) for size in OUTPUTS.values()]
    heat, offset, height, size, turn, speed = (output[0] for output in outputs)
    heat[:] = -9
    heat[1, 6, 2] = 0.0  # a truck, by one half
    offset[:, 6, 2], height[0, 6, 2], size[:, 6, 2] = (0.25, 0.5), 1.5, np.log([2.5, 9, 3])
    turn[:, 6, 2], speed[:, 6, 2] = (-math.sin(math.pi / 2 + 0.3), math.cos(math.pi / 2 + 0.3)), (3, -4)
    layout = PillarLayout(low_m=(-8.0, -8.0, -2.0), high_m=(8.0, 8.0, 4.0), cell_m=(1.0, 1.0, 6.0), stride=2)
    boxes = decode(outputs, layout, 0.4, FLAT)
    assert boxes.center_m.tolist() == [[-8 + 2 * 2.25, -8 + 2 * 6.5, 1.5]]
    assert boxes.size_lwh_m[0] == pytest.approx([9, 2.5, 3])
    assert boxes.yaw_rad[0] == pytest.approx(0.3)
    assert (boxes.label.tolist(), boxes.score.tolist(), boxes.velocity_mps) == (["truck"], [0.5], None)
    turn[:] *= 0.2  # hardly any heading
    assert not len(decode(outputs, layout, 0.4, FLAT))


def test_what_doesnt_fit_is_one_line(tmp_path):
    make_files(tmp_path)
    (tmp_path / "other").mkdir(exist_ok=True)
    make_files(tmp_path / "other", features=11)
    head, encoder = tmp_path / "pts_backbone_neck_head.onnx", tmp_path / "pts_voxel_encoder.onnx"
    for error, said, given in [
        (ConfigError, "needs the voxel encoder", {"encoder": None, "layout": None}),
        (ConfigError, "can't be read", {"encoder": tmp_path / "none.onnx"}),
        (ModelError, "not a voxel encoder", {"encoder": head}),
        (ModelError, "not a voxel encoder of x, y, z and time", {"encoder": tmp_path / "other/pts_voxel_encoder.onnx"}),
        (ModelError, "takes 32 x 32 cells, but range and voxel size give 480 x 480", {"layout": None}),
        (ModelError, "not a bird's-eye network", {"weights": encoder, "encoder": None, "layout": None}),
        (ConfigError, "isn't the head of a CenterPoint", {"weights": BUILTIN}),
        (ConfigError, "knows no 'van'", {"classes": ("van",)}),
        (ConfigError, "leaves it none", {"sensors": "radar"}),
    ]:
        with pytest.raises(error, match=said):
            open_detector(params(tmp_path, **given))


def test_outputs_that_the_layout_does_not_fit_are_refused_before_a_frame(tmp_path, monkeypatch):
    layout = tmp_path / "centerpoint_ml_package.param.yaml"
    for size in (10, 4):
        monkeypatch.setitem(OUTPUTS, "heatmap", size)
        make_files(tmp_path)
        said = rf"'heatmap' has the shape \(1, {size}, 32, 32\) instead of \(1, 5, 32, 32\), .*from network\.layout"
        with pytest.raises(ModelError, match=said):
            open_detector(params(tmp_path))
    monkeypatch.setitem(OUTPUTS, "heatmap", 5)
    make_files(tmp_path)
    layout.write_text(YAML.replace("downsample_factor: 1", "downsample_factor: 2"))
    with pytest.raises(ModelError, match=r"'heatmap' has the shape \(1, 5, 32, 32\) instead of \(1, 5, 16, 16\)"):
        open_detector(params(tmp_path))


def test_variances_are_left_out(tmp_path, monkeypatch):
    points = np.random.default_rng(8).uniform([-8, -8, -1], [8, 8, 3], (900, 3)).astype(np.float32)
    found = []
    for factor in (1, 2):
        for name, size in {"reg": 2, "height": 1, "dim": 3, "rot": 2, "vel": 2}.items():
            monkeypatch.setitem(OUTPUTS, name, factor * size)
        make_files(tmp_path)
        found.append(open_detector(params(tmp_path)).detect(BevPoints(points, NO_RADAR), FLAT, 0.55))
    assert len(found[0]) > 10
    assert found[0].label.tolist() == found[1].label.tolist()
    for name in ("center_m", "size_lwh_m", "yaw_rad", "velocity_mps", "score"):
        np.testing.assert_allclose(getattr(found[1], name), getattr(found[0], name), atol=1e-4)


def test_outputs_that_are_no_arrays_are_refused(tmp_path):
    make_files(tmp_path)
    shape = (1, 32, SIDE, SIDE)
    nodes = [helper.make_node("SequenceConstruct", ["spatial_features"], [name]) for name in OUTPUTS]
    ports = [helper.make_tensor_sequence_value_info(name, TensorProto.FLOAT, shape) for name in OUTPUTS]
    takes = [helper.make_tensor_value_info("spatial_features", TensorProto.FLOAT, shape)]
    model = helper.make_model(helper.make_graph(nodes, "made", takes, ports),
                              opset_imports=[helper.make_opsetid("", 17)], ir_version=8)  # fmt: skip
    onnx.save(model, tmp_path / "pts_backbone_neck_head.onnx")
    with pytest.raises(ModelError, match="'heatmap' has the shape none instead of"):
        open_detector(params(tmp_path))


@pytest.mark.parametrize("file", ["pts_backbone_neck_head.onnx", "pts_voxel_encoder.onnx"])
def test_names_that_are_not_utf8_are_one_line(tmp_path, file):
    make_files(tmp_path)
    data = (tmp_path / file).read_bytes()
    old, new = (b"spatial_", b"spat\xffal_") if "head" in file else (b"input_f", b"inp\xfft_f")
    (tmp_path / file).write_bytes(data.replace(old, new))
    with pytest.raises(ModelError, match=rf"{file}: a name in the model isn't UTF-8"):
        open_detector(params(tmp_path))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("voxel_size: [0.5, 0.5, 6.0]", "voxel_size: [0.5, 0, 6.0]", "voxel_size: expected 3 numbers"),
        ("voxel_size: [0.5, 0.5, 6.0]", "voxel_size: [0.001, 0.5, 6.0]", "no network has this"),
        ("voxel_size: [0.5, 0.5, 6.0]", "voxel_size: here", "voxel_size: expected 3 numbers, got here"),
        ("-2.0, 8.0", "-2.0", "point_cloud_range: expected 6 numbers"),
        ("4.0]", ".nan]", "point_cloud_range: expected 6 numbers"),
        ("downsample_factor: 1", "downsample_factor: 3", "no network has this"),
        ('["CAR", "TRUCK", "BUS", "BICYCLE", "PEDESTRIAN"]', "[]", "class_names: expected a list"),
        ('"TRUCK"', "[TRUCK]", "class_names: expected a list of names"),
        ('"TRUCK"', "2", "class_names: expected a list of names"),
        ("has_twist: true", "has_twist: maybe", "has_twist: expected true or false, got maybe"),
        ("voxel_size", "voxel_sise", "'voxel_sise' isn't known; did you mean 'voxel_size'?"),
        (YAML, "", "expected the parameters of one model"),
        (YAML, "[1, 2]", "expected the parameters of one model"),
        (YAML, "hello", "expected the parameters of one model"),
        (YAML, "rate: 1\nname: b", "expected the parameters of one model"),
        (YAML, YAML + "/other: {}", "expected the parameters of one model"),
        ("/**:", "/**: [", "line"),
    ],
)
def test_damaged_parameters_are_one_line(tmp_path, old, new, said):
    path = tmp_path / "some.param.yaml"
    assert old in YAML
    path.write_text(YAML.replace(old, new))
    with pytest.raises(ConfigError, match=re.escape(said)) as error:
        read_layout(path)
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)


@pytest.mark.parametrize("text", [
    "voxel_size: [0.5, 0.5, 10.0]",  # without node and model
    "/a_node:\n  ros__parameters: {voxel_size: [0.5, 0.5, 10.0], has_variance: true}",
    "ros__parameters:\n  model_params: {voxel_size: [0.5, 0.5, 10.0], max_voxel_size: 9, point_feature_size: 4, x: 1}",
])  # fmt: skip
def test_parameters_count_wherever_they_stand_and_others_are_left_out(tmp_path, text):
    path = tmp_path / "some.param.yaml"
    path.write_text(text)
    assert read_layout(path) == PillarLayout(cell_m=(0.5, 0.5, 10.0))


def test_encoders_of_few_pillars_take_the_first(tmp_path):
    """Of two rows of cells along y an encoder of 10 pillars sees 10 cells, and the rest doesn't count."""
    make_files(tmp_path, num=10)
    side = np.arange(-7.75, 8, CELL_M)
    points = np.array([(x, y, 0.0) for y in (-3.75, 3.75) for x in side], np.float32)
    cut, whole = (
        open_detector(params(tmp_path)).detect(BevPoints(cloud, NO_RADAR), FLAT, 0.5) for cloud in (points[:10], points)
    )
    assert len(cut)
    for name, values in cut.arrays().items():
        np.testing.assert_array_equal(values, getattr(whole, name))
