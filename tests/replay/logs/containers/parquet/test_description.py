"""`log.json` can hold anything."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.replay.logs import builders as b
from tests.replay.logs.containers.parquet import logs

from fbench.replay.contracts.errors import LogError


@pytest.fixture
def path(tmp_path):
    return logs.write(tmp_path / "a", b.sequence(3), b.the_rig())


def stream(**values):
    return lambda log: log["streams"][1].update(values)


def sums(**values):
    return lambda log: log["streams"][1]["checksums"].update(values)


def groups(**values):
    return lambda log: log["streams"][1]["checksums"]["row_groups"].update(values)


def rig(**values):
    return lambda log: log["rigs"][0].update(values)


def mount(**values):
    return lambda log: log["rigs"][0]["mounts"]["top"].update(values)


CASES = [
    (lambda log: log.clear(), 'not the description of a log \\("format": "fbench-parquet" is missing'),
    (lambda log: log.update(format="other"), "not the description of a log"),
    (lambda log: log.update(version=2), "version 2; this fbench reads version 1"),
    (lambda log: log.update(version="1"), "version '1'; this fbench reads version 1"),
    (lambda log: log.update(more=1), "'more': Extra inputs are not permitted; see docs/formats.md"),
    (lambda log: log.pop("streams"), "'streams': Field required"),
    (lambda log: log.update(streams={}), "'streams': Input should be a valid list"),
    (lambda log: log.update(metadata={"a": 1}), "'metadata.a': Input should be a valid string"),
    (stream(file="../a.parquet"), r"stream in file '../a.parquet': not a plain file name"),
    (stream(file="/etc/passwd"), "stream in file '/etc/passwd': not a plain file name"),
    (stream(file=".."), "not a plain file name"),
    (stream(file=""), "not a plain file name"),
    (stream(file="a\0b"), "not a plain file name"),
    (stream(file="nowhere.parquet"), "nowhere.parquet: is missing"),
    (stream(file="x" * 5000), "can't be read .File name too long"),
    (stream(file="cam.image.parquet"), "file 'cam.image.parquet' belongs to two streams"),
    (stream(file="log.json"), "log.json: (truncated|changed)"),
    (stream(file=7), "'streams.1.file': Input should be a valid string"),
    (stream(kind="sonar"), "'streams.1.kind': Input should be 'camera', 'lidar'"),
    (stream(kind="radar", topic=""), None),
    (stream(kind="camera"), "stream of kind 'camera' without column encoding, width, height, data"),
    (stream(kind="raw"), "without column data"),
    (stream(sensor=""), "stream of kind 'lidar' without sensor in log.json"),
    (stream(num_rows=-1), "'streams.1.num_rows': Input should be greater than or equal to 0"),
    (stream(checksums=1), "'streams.1.checksums': Input should be"),
    (sums(size=2**70), "'streams.1.checksums.size': Input should be less than"),
    (sums(size=1), "changed, it has .* bytes instead of 1"),
    (sums(footer_crc32=1), "damaged, the checksum of its footer doesn't match"),
    (groups(offset=[]), "columns of different length"),
    (groups(num_rows=[2]), "its row groups aren't those of log.json"),
    (groups(num_rows=[2**63]), "its row groups aren't those of log.json"),
    (groups(length=[2**63]), r"row group 0 has \d+ bytes, the limit is \d+"),
    (rig(log_ns=-1), "'rigs.0.log_ns'"),
    (mount(kind="sonar"), "'rigs.0.mounts.top.kind'"),
    (mount(translation_m=[1.0]), r"sensor 'top': Mount.translation_m: expected float64 \(3\), got float64 \(1,\)"),
    (mount(rotation_xyzw=[0, 0, 0, 0]), "sensor 'top' has no valid pose"),
    (lambda log: log["rigs"][0]["cameras"]["cam"].update(size_wh=[0, 4]), "size_wh"),
    (lambda log: log["rigs"][0]["cameras"]["cam"].update(K=[[1.0], []]), "camera 'cam'"),
    (lambda log: log["rigs"][0]["cameras"]["cam"].update(K=[[0, 0, 0]] * 3), "camera 'cam' has no valid focal length"),
]


@pytest.mark.parametrize(("change", "match"), CASES)
def test_wrong_content_is_one_line(path, change, match):
    logs.edit(path, change)
    if match is None:
        logs.content(logs.read(path)[0])
        return
    with pytest.raises(LogError, match=match) as error:
        logs.content(logs.read(path)[0])
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "isn't JSON"),
        ("[]", "not the description of a log"),
        ('{"format": "fbench-parquet", "format": "x"}', "key 'format' is there twice"),
        ('{"format": NaN}', "NaN isn't a number"),
        ('{"format": Infinity}', "Infinity isn't a number"),
        ('{"format": "fbench-parquet", "version": 1, "streams": [], "rigs": [{"log_ns": 1e999}]}', "rigs.0.log_ns"),
        ("[" * 200_000, "nested too deeply"),
        ('{"format": ' + "9" * 6000 + "}", "isn't JSON"),
        ('{"format": "fbench-parquet", "version": 1, "digest": 3, "streams": []}', "digest doesn't match"),
        ('{"format": "\ud800"}', "isn't JSON"),
        ('{"format": "fbench-parquet", "version": 1, "streams": [], "log_id": "\\ud800"}', "isn't JSON .*surrogates"),
    ],
)
def test_wrong_text_is_one_line(path, text, match):
    (path / "log.json").write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(LogError, match=match) as error:
        logs.read(path)
    assert "\n" not in str(error.value)


def test_infinite_numbers_of_a_rig_are_refused(path):
    file = path / "log.json"
    logs.edit(path, lambda log: None)
    file.write_text(file.read_text().replace("1.9]", "1e999]"))
    with pytest.raises(LogError, match=r"translation_m.*finite"):
        logs.read(path)


def test_too_large(path):
    (path / "log.json").write_bytes(b" " * (16 * 1024 * 1024 + 1))
    with pytest.raises(LogError, match=r"16777217 bytes, the limit is 16777216"):
        logs.read(path)


def test_links_lead_nowhere(path, tmp_path):
    for name in ("top.points.parquet", "log.json"):
        file = path / name
        file.rename(tmp_path / name)
        file.symlink_to(tmp_path / name)
        with pytest.raises(LogError, match=f"{name}: can't be read .a link, which could lead out of the log"):
            logs.read(path)
        file.unlink()
        (tmp_path / name).rename(file)


def test_fifos_and_folders_are_not_read(path):
    import os

    file = path / "top.points.parquet"
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(LogError, match=r"not a regular file"):
        logs.read(path)
    file.unlink()
    file.mkdir()
    with pytest.raises(LogError, match=r"top.points.parquet"):
        logs.read(path)


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda children: st.lists(children, max_size=3) | st.dictionaries(st.text(max_size=5), children, max_size=3),
    max_leaves=5,
)
keys = st.sampled_from(["file", "kind", "sensor", "topic", "channel", "num_rows", "checksums"])


@pytest.mark.slow
@settings(max_examples=100)
@given(st.dictionaries(keys, values, max_size=3), st.dictionaries(st.sampled_from(["rigs", "metadata"]), values))
def test_any_values(tmp_path_factory, in_stream, in_log):
    path = tmp_path_factory.mktemp("any") / "a"
    logs.write(path, b.sequence(1))

    def change(log):
        log["streams"][0].update(in_stream)
        log.update(in_log)

    logs.edit(path, change)
    error = logs.refusal(lambda: logs.content(logs.read(path)[0]))
    assert "\n" not in str(error)


def test_description_can_be_read_by_people(path):
    text = (path / "log.json").read_text()
    assert '"translation_m": [1.7, 0.3333333333333333, 1.2]' in text
    assert json.loads(text)["metadata"] == {"place": "Köln"}
