"""`fbench init`, as a user calls it."""

import tomllib

from fbench.replay.setup.configuration import Config, config_place, find_config


def test_writes_beside_the_log_and_says_why(fbench, log, tmp_path):
    result = fbench("init", log)
    place = tmp_path / "fbench.toml"
    assert result.code == 0
    assert "wrote" in result.out
    assert "/lidar/points" in result.out
    config = Config.model_validate(tomllib.loads(place.read_text()))
    assert sorted(config.sensors) == ["camera", "lidar", "radar"]
    assert config.truth.topics == ("/truth/boxes",)
    assert fbench("replay", log, "-p", "lidar3d", "-o", tmp_path / "run").code == 0


def test_existing_files_stay(fbench, log, tmp_path):
    place = tmp_path / "fbench.toml"
    place.write_text("mine")
    result = fbench("init", log)
    assert result.code == 2
    assert result.err == f"fbench: {place}: exists; replace it with --overwrite, or name another file with -o\n"
    assert place.read_text() == "mine"
    assert fbench("init", log, "--overwrite").code == 0
    assert place.read_text() != "mine"
    assert fbench("init", log, "-o", tmp_path / "made/here.toml").code == 0
    assert fbench("init", log, "-o", "/dev/null/here.toml").code == 2
    assert fbench("init", log, "-o", tmp_path).code == 2


def test_json(fbench, log, tmp_path):
    result = fbench("init", log, "-o", tmp_path / "other.toml", "--json")
    content = result.json()
    assert content["config"] == str(tmp_path / "other.toml")
    rows = (tmp_path / "other.toml").read_text().splitlines()
    for line in content["lines"]:
        assert line["key"] in rows[line["line"] - 1]
    assert [line["value"] for line in content["lines"] if line["key"] == "kind"] == ["camera", "lidar", "radar"]
    assert content["left_out"] == []


def test_what_is_no_log(fbench, tmp_path):
    other = tmp_path / "other.mcap"
    other.write_bytes(b"hello")
    result = fbench("init", other)
    assert result.code == 3
    assert len(result.err.splitlines()) == 1
    assert not (tmp_path / "fbench.toml").exists()


def test_where_the_file_belongs(tmp_path):
    folder, parquet = tmp_path / "parts", tmp_path / "log.parquet"
    folder.mkdir()
    parquet.mkdir()
    (parquet / "log.json").write_text("{}")
    assert config_place(tmp_path / "a.mcap") == tmp_path / "fbench.toml"
    assert config_place(folder) == folder / "fbench.toml"
    assert config_place(folder / "metadata.yaml") == folder / "fbench.toml"
    assert config_place(parquet) == config_place(parquet / "log.json") == tmp_path / "fbench.toml"
    assert find_config(folder) is None
    (folder / "fbench.toml").write_text("version = 1\n")
    assert find_config(folder) == folder / "fbench.toml"


def test_folder_that_is_the_current_one(fbench, log, tmp_path, monkeypatch):
    (tmp_path / "drive").mkdir()
    log.rename(tmp_path / "drive" / "part_0.mcap")
    monkeypatch.chdir(tmp_path / "drive")
    assert fbench("init", ".").code == 0
    assert (tmp_path / "drive" / "fbench.toml").read_text().startswith("# What fbench takes from 'drive',")
    assert "run: runs/drive-lidar3d\n" in fbench("replay", ".", "-p", "lidar3d").out
