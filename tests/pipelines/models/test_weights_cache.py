"""What is in the cache is the published file, whoever put it there."""

import hashlib
import resource
from dataclasses import replace
from pathlib import Path

import pytest

from fbench.pipelines.models.weights import (
    CATALOGUE,
    Entry,
    file_blocks,
    find_entry,
    origin,
    resolve,
    resolve_settings,
    state,
    store,
    weights_folder,
)
from fbench.pipelines.variants.camera2d import Camera2DParams
from fbench.replay.contracts.errors import ConfigError, ModelError

CONTENT = b"weights" * 1000
ENTRY = Entry(
    "tiny", "Tiny", "Nobody", "MIT", 1.5, (8, 8), "http://page", "https://host/path/tiny_model.onnx",
    ("https://host",), len(CONTENT), hashlib.sha256(CONTENT).hexdigest(),
)  # fmt: skip


@pytest.fixture
def cached(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("FBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    return tmp_path / "cache" / "weights" / "tiny_model.onnx"


def test_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    monkeypatch.delenv("FBENCH_CACHE", raising=False)
    assert weights_folder() == tmp_path / "xdg" / "fbench" / "weights"
    monkeypatch.setenv("FBENCH_CACHE", str(tmp_path / "mine"))
    assert weights_folder() == tmp_path / "mine" / "weights"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FBENCH_CACHE", "near")
    assert weights_folder() == tmp_path / "near" / "weights"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("FBENCH_CACHE", "")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert weights_folder() == tmp_path / "home" / ".cache" / "fbench" / "weights"


def test_without_a_home_the_error_says_what_to_name(monkeypatch: pytest.MonkeyPatch):
    for name in ("XDG_CACHE_HOME", "FBENCH_CACHE", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("os.getuid", lambda: 4_000_000)  # whom the system doesn't know
    with pytest.raises(ConfigError, match=r"no folder for weights \(.*home.*\): name one in FBENCH_CACHE"):
        weights_folder()


def test_states(cached: Path):
    assert state(ENTRY, cached) == "absent"
    store(ENTRY, [CONTENT[:10], CONTENT[10:]], "here", cached)
    assert state(ENTRY, cached) == "good"
    cached.write_bytes(CONTENT[:-1])
    assert state(ENTRY, cached) == "damaged"
    cached.write_bytes(CONTENT[:-1] + b"!")
    assert state(ENTRY, cached) == "damaged"


def test_files_are_taken_in_and_checked(cached: Path, tmp_path: Path):
    file = tmp_path / "mine.onnx"
    file.write_bytes(CONTENT)
    store(ENTRY, file_blocks(file), str(file), cached)
    assert cached.read_bytes() == CONTENT
    file.write_bytes(CONTENT[:-1] + b"!")
    with pytest.raises(ModelError, match=r"mine\.onnx: isn't tiny as published, not taken \(sha256 "):
        store(ENTRY, file_blocks(file), str(file), cached)
    for absent in (tmp_path / "none.onnx", tmp_path):
        with pytest.raises(ConfigError, match=r"weights can't be read \("):
            store(ENTRY, file_blocks(absent), str(absent), cached)
    assert [p.name for p in cached.parent.iterdir()] == [cached.name]


def test_a_folder_that_cannot_be_written(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ModelError, match=r"file/weights: tiny_model\.onnx can't be written there \(Not a directory\)"):
        store(ENTRY, [CONTENT], "here", tmp_path / "file" / "weights" / "tiny_model.onnx")
    assert (tmp_path / "file").read_text() == ""


def test_a_disk_that_takes_no_more(cached: Path):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (ENTRY.num_bytes // 2, limits[1]))
    try:
        with pytest.raises(ModelError, match=r"can't be written there \(File too large\); FBENCH_CACHE may name"):
            store(ENTRY, [CONTENT], "here", cached)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list(cached.parent.iterdir()) == []


def test_an_interruption_leaves_nothing(cached: Path):
    def blocks():
        yield CONTENT[:10]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        store(ENTRY, blocks(), "here", cached)
    assert list(cached.parent.iterdir()) == []


def test_a_name_is_its_file(cached: Path):
    with pytest.raises(ConfigError, match=rf"weights 'tiny' aren't at {cached}: fbench weights get tiny$"):
        resolve(Path("tiny"), [ENTRY])
    store(ENTRY, [CONTENT], "here", cached)
    assert resolve(Path("tiny"), [ENTRY]) == cached
    assert resolve(cached, [ENTRY]) == cached


def test_a_name_is_refused_where_the_file_is_another(cached: Path):
    cached.parent.mkdir(parents=True)
    cached.write_bytes(CONTENT[::-1])
    with pytest.raises(ModelError, match=r"isn't tiny as published; to fetch it anew: fbench weights get tiny$"):
        resolve(Path("tiny"), [ENTRY])


def test_paths_stay_as_they_are(cached: Path, tmp_path: Path):
    for path in (None, Path("none.onnx"), Path("folder/tiny"), Path("/tiny")):
        assert resolve(path, [ENTRY]) is path
    (tmp_path / "tiny").mkdir()
    with pytest.raises(ConfigError, match="aren't at"):  # a folder is no file
        resolve(Path("tiny"), [ENTRY])
    (tmp_path / "tiny").rmdir()
    (tmp_path / "tiny").write_bytes(b"mine")
    assert resolve(Path("tiny"), [ENTRY]) == Path("tiny")


def test_auto_and_none_are_no_names(cached: Path):
    assert resolve("auto", [ENTRY]) == "auto"
    assert resolve_settings(("left.weights=auto", "right.weights=none"), [ENTRY]) == (
        "left.weights=auto", "right.weights=none",
    )  # fmt: skip


@pytest.mark.parametrize("name", ["x" * 300, "x" * 5000, "no\0name"])
def test_names_that_no_file_can_have(cached: Path, name: str):
    with pytest.raises(ConfigError, match=f"unknown weights '{name[:2]}"):
        resolve(Path(name), [ENTRY])


def test_a_folder_that_is_called_as_no_weights_are(cached: Path, tmp_path: Path):
    (tmp_path / "models").mkdir()
    for name in ("models", "."):
        with pytest.raises(ConfigError, match=rf"weights '{name}': a folder; name an ONNX file"):
            resolve(Path(name), [ENTRY])


def test_unknown_names(cached: Path):
    with pytest.raises(ConfigError, match=r"unknown weights 'tinny'; did you mean 'tiny'\?"):
        resolve(Path("tinny"), [ENTRY])
    with pytest.raises(ConfigError, match="there are: deimv2-atto, deimv2-femto"):
        find_entry("resnet")


def test_names_in_settings_of_sensors(cached: Path):
    store(ENTRY, [CONTENT], "here", cached)
    settings = ("left.weights=tiny", "left.min_score=0.3", "right.weights=none", "top.weights=a.onnx")
    expected = (f"left.weights={cached}", "left.min_score=0.3", "right.weights=none", "top.weights=a.onnx")
    assert resolve_settings(settings, [ENTRY]) == expected
    with pytest.raises(ConfigError, match="fbench weights get deimv2-femto"):
        Camera2DParams(by_sensor=("left.weights=deimv2-femto",))


def test_the_catalogue_is_sound():
    assert len({entry.name for entry in CATALOGUE}) == len({entry.file_name for entry in CATALOGUE}) == len(CATALOGUE)
    for entry in CATALOGUE:
        assert "." not in entry.name
        assert entry.licence in ("Apache-2.0", "MIT", "BSD-3-Clause")
        assert int(entry.sha256, 16) > 0
        assert len(entry.sha256) == 64
        assert origin(entry.url) in entry.origins
        assert all(address.startswith("https://") for address in entry.origins)


def test_the_real_file_is_the_published_one(shared: Path):
    path = shared / "weights" / "deimv2_femto" / "deimv2_hgnetv2_femto_coco.onnx"
    if not path.exists():
        pytest.skip(f"no weights at {path}")
    entry = find_entry("deimv2-femto")
    assert state(entry, path) == "good"
    assert state(replace(entry, sha256="0" * 64), path) == "damaged"
