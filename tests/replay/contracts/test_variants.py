"""Variants on top of pipelines."""

import pytest

from fbench.pipelines.sensors.camera.detector import CITY_WEIGHTS
from fbench.replay.contracts.errors import EXIT_USAGE, ConfigError
from fbench.replay.contracts.plugins import make_pipeline, pipeline_class, pipeline_parameters
from fbench.replay.contracts.variants import find_variants, sensors_of, variant_of


@pytest.fixture
def detector(tmp_path):
    """An ONNX file."""
    path = tmp_path / "absolute.onnx"
    path.write_bytes(CITY_WEIGHTS.read_bytes())
    return path


@pytest.fixture
def variant(tmp_path):
    """Write a variant of a pipeline, and return what it is called on the command line."""

    def write(text="", base="lidar3d", name="mine", folder=tmp_path):
        folder.mkdir(exist_ok=True)
        (folder / "mine.toml").write_text(f'name = "{name}"\nbase = "{base}"\n{text}')
        return str(folder / "mine.toml")

    return write


def test_a_variant_is_its_base_with_other_parameters(variant):
    path = variant("[parameters]\nmin_score = 0.25\nlidar.cluster.eps_m = 0.75")
    pipeline, parameters = make_pipeline(path, [])
    plain = pipeline_parameters("lidar3d", [])
    assert type(pipeline) is pipeline_class("lidar3d") is pipeline_class(path)
    assert parameters == plain | {"min_score": 0.25, "lidar.cluster.eps_m": 0.75}
    assert parameters == pipeline_parameters(path, [])


def test_settings_of_the_command_line_come_last(variant):
    path = variant("[parameters]\nmin_score = 0.25\nlidar.cluster.eps_m = 0.75")
    parameters = make_pipeline(path, ["min_score=0.125"])[1]
    assert (parameters["min_score"], parameters["lidar.cluster.eps_m"]) == (0.125, 0.75)


def test_parameters_of_single_sensors(variant):
    path = variant("[parameters.'sensing/top']\nmin_range_m = 1.5")
    assert make_pipeline(path, [])[1]["sensing/top.min_range_m"] == "1.5"


def test_sensors_of_the_command_line_replace_those_of_a_variant(variant):
    path = variant("sensors = ['top', '!rear']")
    assert sensors_of(path, []) == ["top", "!rear"]
    assert sensors_of(path, ["rear"]) == ["rear"]
    assert sensors_of("lidar3d", []) == []


@pytest.mark.parametrize("text", ["lidar3d", "mine.py:Mine", "exec:./a/b", "recorded:/a/b", "a/b", "a/b/c", "", "/"])
def test_other_names_are_no_variants(text):
    assert variant_of(text) is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[parameters]\nmin_skore = 1", "unknown parameter 'min_skore'; did you mean 'min_score'?"),
        ("[parameters]\nmin_score = 2", "min_score: expected between 0 and 1, got 2"),
        ("[parameters]\nmin_score = 'high'", "min_score=high: expected float"),
        ("[parameters]\nmin_score = true", "min_score=true: expected float"),
        ("[parameters]\nmin_score = nan", "min_score=nan: expected float"),
        ("[parameters]\nmin_score = [0.1, 0.2]", "min_score=0.1,0.2: expected float"),
        ("[parameters]\nlidar.cluster.min_points = 1.5", "lidar.cluster.min_points=1.5: expected int"),
        ("[parameters]\nlidar.cluster.with_height = 1", "lidar.cluster.with_height=1: expected bool"),
        ("[parameters]\nlidar.cluster = 1", "'lidar.cluster' isn't a single parameter"),
        ("[parameters]\nlidar.shape.top_m = [1]", "lidar.shape.top_m=1: expected tuple"),
        ("[parameters]\nby_sensor = ['a.min_range_m=1']", "unknown parameter 'by_sensor'"),
        ("detect_every = 0", "detect_every: expected at least 1, got 0"),
    ],
)
def test_parameters_that_are_wrong(variant, text, message):
    path = variant(text)
    with pytest.raises(ConfigError) as caught:
        make_pipeline(path, [])
    assert str(caught.value).startswith(f"{path}: {message}")
    assert caught.value.exit_code == EXIT_USAGE
    with pytest.raises(ConfigError):
        pipeline_parameters(path, [])


@pytest.mark.parametrize(
    ("base", "message"),
    [
        ("lidar4d", "'base': unknown pipeline 'lidar4d'; did you mean 'lidar3d'?"),
        ("lidar3d:x", "'base': unknown pipeline 'lidar3d:x'; did you mean 'lidar3d'?"),
        ("exec", "'base': exec runs a program; name it on the command line"),
        ("exec:/bin/true", "'base': unknown pipeline 'exec:/bin/true'"),
        ("evil.py:Evil", "'base': expected the name of a pipeline, got the file evil.py:Evil"),
        ("thesis/late3d", "'base': thesis/late3d is a variant itself; name a pipeline, and set all"),
        ("thesis/late4d", "unknown pipeline 'thesis/late4d'; did you mean 'thesis/late3d'?"),
        ("mine.toml", "'base': mine.toml is a variant itself"),
        ("other.toml", "'base': other.toml is a variant itself"),
    ],
)
def test_bases_that_are_wrong(variant, base, message, tmp_path, monkeypatch):
    """A file that names itself, too; and no code of a file is run."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "evil.py").write_text("raise SystemExit('ran')")
    with pytest.raises(ConfigError) as caught:
        make_pipeline(variant(base=base), [])
    assert message in str(caught.value)
    assert caught.value.exit_code == EXIT_USAGE


def test_the_name_of_a_pipeline_is_taken(variant):
    with pytest.raises(ConfigError, match=r"mine\.toml: 'name': there is a pipeline 'late3d'; choose another"):
        make_pipeline(variant(name="late3d"), [])


def test_a_base_without_parameters(variant, monkeypatch, tmp_path):
    from fbench.replay.contracts import plugins

    class Plain:
        start = reset = step = lambda *_: None

    monkeypatch.setattr(plugins, "load", lambda group, name: Plain)
    assert make_pipeline(variant(), [])[1] == {}
    with pytest.raises(ConfigError, match=r"mine\.toml: pipeline 'lidar3d' takes no parameters"):
        make_pipeline(variant("[parameters]\na = 1"), [])


def weights_of(path, parameter):
    described = make_pipeline(path, [])[1][parameter]
    assert isinstance(described, dict)
    return described["file"]


def test_files_are_relative_to_the_variant(variant, tmp_path, monkeypatch, detector):
    """Wherever it is used from; absolute ones stay."""
    folder = tmp_path / "variants"
    monkeypatch.chdir(tmp_path)
    (folder / "weights").mkdir(parents=True)
    (folder / "weights" / "a.onnx").symlink_to(detector)
    for text in ("weights/a.onnx", "../absolute.onnx", str(detector)):
        path = variant(f"[parameters]\ncamera.weights = '{text}'", "camera2d", folder=folder)
        assert weights_of(path, "camera.weights") == text.rpartition("/")[2]


def test_files_of_single_sensors_are_relative_too(variant, detector):
    path = variant(f"[parameters.front]\nweights = '{detector.name}'", "camera2d")
    assert weights_of(path, "front.weights") == detector.name


def test_files_that_are_absent_and_names_of_weights(variant, tmp_path, monkeypatch):
    monkeypatch.setenv("FBENCH_CACHE", str(tmp_path / "cache"))
    with pytest.raises(ConfigError, match=rf"{tmp_path}/a\.onnx: weights can't be read"):
        make_pipeline(variant("[parameters]\ncamera.weights = 'a.onnx'", "camera2d"), [])
    with pytest.raises(ConfigError, match=r"weights 'yolox-tiny' aren't at .*: fbench weights get yolox-tiny"):
        make_pipeline(variant("[parameters]\ncamera.weights = 'yolox-tiny'", "camera2d"), [])
    parameters = make_pipeline(variant("[parameters]\ncamera.weights = 'none'", "camera2d"), [])[1]
    assert parameters["camera.weights"] is None


def test_built_in_variants_are_called_by_group_and_name():
    variants = [variant for variant, _ in find_variants()]
    assert len(variants) >= 10
    for variant in variants:
        assert variant_of(variant.name) == variant
        assert variant.title
        assert pipeline_parameters(variant.name, [])
    with pytest.raises(ConfigError, match=r"unknown pipeline 'thesis/late3'; did you mean 'thesis/late3d'?"):
        make_pipeline("thesis/late3", [])
    with pytest.raises(ConfigError, match=r"unknown pipeline 'thesys/late3d'; did you mean 'thesis/late3d'?"):
        make_pipeline("thesys/late3d", [])
