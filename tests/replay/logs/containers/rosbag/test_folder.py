"""Folders of rosbag2: which files, in which order, and what hostile metadata can do."""

import time
from pathlib import Path

import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer
from tests.replay.logs.containers.rosbag import builders as b

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.containers.rosbag.folder import (
    Part,
    is_recording,
    missing_numbers,
    read_metadata,
    rosbag2_files,
)
from fbench.replay.logs.open import open_container


def files(folder):
    faults = FaultLog()
    return rosbag2_files(folder, faults), faults


def folder_of(tmp_path, names, metadata=None):
    folder = tmp_path / "bag"
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"x")
    if metadata is not None:
        folder.mkdir(exist_ok=True)
        (folder / "metadata.yaml").write_text(metadata)
    return folder


def metadata(names, storage="sqlite3", mode="", fmt=""):
    listed = "".join(f"    - {name}\n" for name in names)
    return (
        f"rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: {storage}\n  relative_file_paths:\n{listed}"
        f"  compression_mode: {mode!r}\n  compression_format: {fmt!r}\n"
    )


@pytest.mark.parametrize("version", [8, 9])
@pytest.mark.parametrize("mode", ["none", "message"])
@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_recordings_of_rosbags(tmp_path, version, mode, storage):
    folder = b.write_bag2(tmp_path / "bag", b.rows(), version, mode, storage)
    (part,), faults = files(folder)
    compression = "zstd" if mode == "message" else ""
    assert part == Part(folder / ("bag.db3" if storage == "sqlite3" else "bag.mcap"), storage, compression)
    container = open_container(folder, faults)
    got = [(entry.log_ns, entry.topic, bytes(entry.data)) for entry in container.entries(frozenset(container.channels))]
    assert sorted(got) == b.read_bag2(folder)
    assert not faults.num_lost


@pytest.mark.parametrize("named", ["folder", "file"])
@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_compressed_messages_without_metadata(tmp_path, storage, named):
    messages = [(number, log_ns, b"\0\1\0\0" + data) for number, log_ns, data in b.rows()]
    folder = b.write_bag2(tmp_path / "bag", messages, 9, "message", storage)
    expected = b.read_bag2(folder)
    (folder / "metadata.yaml").unlink()
    faults = FaultLog()
    (part,) = folder.iterdir()
    container = open_container(folder if named == "folder" else part, faults)
    got = [(entry.log_ns, entry.topic, bytes(entry.data)) for entry in container.entries(frozenset(container.channels))]
    assert sorted(got) == expected
    assert not faults.num_lost


@pytest.mark.parametrize("size", [300 * 2**20, 0])
@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_compressed_messages_without_metadata_that_are_bombs_or_damaged(tmp_path, storage, size):
    bad = zstandard.compress(bytes(size)) if size else b"\x28\xb5\x2f\xfd\xff\xff"
    good = zstandard.compress(b"\0\1\0\0fine")
    folder = b.write_bag2(tmp_path / "bag", [(0, 5, good), (0, 6, bad), (0, 7, good)], storage=storage)
    (folder / "metadata.yaml").unlink()
    faults = FaultLog()
    container = open_container(folder, faults)
    assert [entry.log_ns for entry in container.entries(frozenset(container.channels))] == [5, 7]
    assert faults.counts["LOG004"] == 1
    assert ("more than the limit" if size else "zstd data are damaged") in faults.places["LOG004"][0]


def test_other_encodings_may_begin_like_zstd(tmp_path):
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/bytes", "custom", 0)
        writer.add_message(channel, 5, b"\x28\xb5\x2f\xfdraw", 5)
        writer.finish()
    container = open_container(path, FaultLog())
    assert [bytes(entry.data) for entry in container.entries(frozenset(container.channels))] == [b"\x28\xb5\x2f\xfdraw"]


@pytest.mark.parametrize("has_metadata", [True, False])
@pytest.mark.parametrize("suffix", [".db3", ".mcap"])
def test_compressed_files_say_what_undoes_it(tmp_path, suffix, has_metadata):
    name = f"bag_0{suffix}.zstd"
    folder = folder_of(tmp_path, [name], metadata([name], mode="FILE", fmt="zstd") if has_metadata else None)
    (folder / name).write_bytes(zstandard.compress(b"SQLite format 3\x00"))
    for path in (folder, folder / name):
        with pytest.raises(LogError, match=rf"{name}: compressed as a whole; decompress it first \(`unzstd {name}`\)"):
            open_container(path, FaultLog())


def test_bags_of_ros_1_come_by_number_whatever_the_order_of_the_folder(tmp_path, monkeypatch):
    names = ["a_01.bag", "a_1.bag", "a_2.bag", "a_10.bag"]
    for name in names:
        b.write_bag1(tmp_path / name, [(0, b.START_NS, name.encode())])
    listed = list(tmp_path.iterdir())
    for order in (listed, listed[::-1]):
        monkeypatch.setattr(Path, "iterdir", lambda path, order=order: iter(order))
        container = open_container(tmp_path, FaultLog())
        assert [bytes(entry.data).decode() for entry in container.entries(frozenset(container.channels))] == names


def test_listed_order_then_others_by_number(tmp_path):
    names = ["b_10.db3", "b_9.db3", "b_2.db3", "z.db3", "a.mcap", "notes.txt"]
    folder = folder_of(tmp_path, names, metadata(["z.db3", "b_9.db3"]))
    parts, faults = files(folder)
    assert [part.path.name for part in parts] == ["z.db3", "b_9.db3", "a.mcap", "b_2.db3", "b_10.db3"]
    assert [part.storage for part in parts] == ["sqlite3", "sqlite3", "mcap", "sqlite3", "sqlite3"]
    assert not faults.counts


def test_without_metadata_by_number(tmp_path):
    folder = folder_of(tmp_path, ["b_10.db3", "b_0.db3", "b_2.db3"])
    assert is_recording(folder)
    assert [part.path.name for part in files(folder)[0]] == ["b_0.db3", "b_2.db3", "b_10.db3"]


def test_early_versions_wrote_the_folder_too(tmp_path):
    folder = folder_of(tmp_path, ["bag_0.db3"], metadata(["bag/bag_0.db3"]))
    assert [part.path for part in files(folder)[0]] == [folder / "bag_0.db3"]


def test_missing_file_is_counted(tmp_path):
    parts, faults = files(folder_of(tmp_path, ["b_0.db3"], metadata(["b_0.db3", "b_1.db3"])))
    assert len(parts) == 1
    assert faults.places == {"LOG011": ["bag: 'b_1.db3'"]}


def test_link_within_the_folder_is_no_second_file(tmp_path):
    folder = folder_of(tmp_path, ["b_0.db3"])
    (folder / "a.db3").symlink_to("b_0.db3")
    assert len(files(folder)[0]) == 1


@pytest.mark.parametrize("name", ["/etc/passwd", "../b_0.db3", "x/../../b_0.db3", "link.db3"])
def test_paths_out_of_the_folder(tmp_path, name):
    folder = folder_of(tmp_path, ["b_0.db3"], metadata([name]))
    (tmp_path / "b_0.db3").write_bytes(b"x")
    if name == "link.db3":
        (folder / name).symlink_to(tmp_path / "b_0.db3")
    with pytest.raises(LogError, match=rf"'{name}' leads out of the folder"):
        files(folder)


def test_unlisted_link_and_metadata_out_of_the_folder(tmp_path):
    folder = folder_of(tmp_path, ["b_0.db3"])
    (tmp_path / "secret").write_text("password: x")
    (folder / "metadata.yaml").symlink_to(tmp_path / "secret")
    with pytest.raises(LogError, match=r"'metadata\.yaml' leads out of the folder"):
        files(folder)
    (folder / "metadata.yaml").unlink()
    (folder / "c.db3").symlink_to(tmp_path / "secret")
    with pytest.raises(LogError, match=r"'c\.db3' leads out of the folder"):
        files(folder)


@pytest.mark.parametrize("name", ["a\\0b", "a" * 5000, "loop.db3"])
def test_names_that_are_no_paths(tmp_path, name):
    folder = folder_of(tmp_path, ["b_0.db3"], metadata([f'"{name}"']))
    (folder / "loop.db3").symlink_to("loop.db3")
    with pytest.raises(LogError, match="is no path of a file"):
        files(folder)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("names", "text", "match"),
    [
        ([], None, "no recording of rosbag2"),
        (["notes.txt"], None, "no recording of rosbag2"),
        (["b.db3.zstd"], None, r"compressed as a whole; decompress it first \(`unzstd b\.db3\.zstd`\)"),
        (["a.db3", "b.mcap.zstd"], None, "compressed as a whole"),
        (["b.db3.zstd"], metadata(["b.db3.zstd"], mode="FILE", fmt="zstd"), "compressed as a whole"),
        (["b.bin"], metadata(["b.bin"], "leveldb"), "unknown storage 'leveldb'; fbench reads sqlite3 and mcap"),
        (["b.db3"], metadata(["b.db3"], mode="MESSAGE", fmt="lz4"), "unknown message compression 'lz4'"),
        (["b.db3"], metadata(["b.db3"], mode="block"), "unknown compression mode 'block'"),
        (["b.db3"], "", "no list 'relative_file_paths'"),
        (["b.db3"], "rosbag2_bagfile_information: 7", "no list 'relative_file_paths'"),
        (["b.db3"], "rosbag2_bagfile_information: {relative_file_paths: [[a]]}", "no list 'relative_file_paths'"),
        (
            ["b.db3"],
            "rosbag2_bagfile_information: {relative_file_paths: [], compression_mode: [x]}",
            "'compression_mode' is no text",
        ),
        (["b.db3"], "a: [b\nc: d", r"can't be parsed .*remove it to read the files as they are"),
        (["b.db3"], "a: 1\na: 2", "can't be parsed .*duplicate key"),
        (["b.db3"], "a: 1\n---\na: 2", "can't be parsed .*more than one document"),
        (["b.db3"], "? [a]\n: 2", "can't be parsed .*a list or mapping as a key"),
        (["b.db3"], "a: &x [1]\nb: *x", "line 1: YAML anchors and aliases aren't allowed"),
        (["b.db3"], "[" * 2000, "nested more than 32 deep"),
        (["b.db3"], "a: !!python/object/apply:os.system [ls]", "no list 'relative_file_paths'"),
    ],
)
def test_what_cannot_be_read(tmp_path, names, text, match):
    folder = folder_of(tmp_path, names, text)
    folder.mkdir(exist_ok=True)
    with pytest.raises(LogError, match=match):
        files(folder)


def test_decompressed_beside_what_was_listed(tmp_path):
    text = metadata(["b.db3.zstd"], mode="FILE", fmt="zstd")
    parts, faults = files(folder_of(tmp_path, ["b.db3", "b.db3.zstd"], text))
    assert parts == [Part(tmp_path / "bag" / "b.db3", "sqlite3")]
    assert not faults.counts


def test_storage_as_told_where_the_name_does_not(tmp_path):
    parts, _ = files(folder_of(tmp_path, ["b.bin"], metadata(["b.bin"])))
    assert parts[0].storage == "sqlite3"


def test_metadata_too_large(tmp_path):
    path = tmp_path / "metadata.yaml"
    path.write_bytes(b"#" * (4 * 1024 * 1024 + 1))
    with pytest.raises(LogError, match="has more than the limit of 4194304 bytes"):
        read_metadata(path)


def test_metadata_not_text(tmp_path):
    path = tmp_path / "metadata.yaml"
    path.write_bytes(b"a: \xff")
    with pytest.raises(LogError, match=r"isn't UTF-8 text .* at byte 3"):
        read_metadata(path)


def test_alias_bomb_is_refused_at_once(tmp_path):
    path = tmp_path / "metadata.yaml"
    lines = ["a0: &a0 [x, x, x]"] + [f"a{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 9)}]}}" for i in range(1, 12)]
    path.write_text("\n".join(lines))
    start = time.process_time()
    with pytest.raises(LogError, match="anchors and aliases aren't allowed"):
        read_metadata(path)
    assert time.process_time() - start < 20


yaml_like = st.text(st.sampled_from("ab:-[]{},&*!|>%@`'\"#?\n\t 0.~<\\\u2028\x00é"), max_size=60)


@given(yaml_like | st.text(max_size=40))
def test_arbitrary_text_gives_typed_errors(tmp_path_factory, text):
    path = tmp_path_factory.getbasetemp() / "metadata.yaml"
    path.write_text(text, errors="surrogatepass")
    with pytest.raises(LogError):
        read_metadata(path)


@pytest.mark.parametrize(
    ("names", "missing"),
    [
        (["a_0.mcap", "a_1.mcap", "a_3.mcap", "a_6.mcap"], ["a_2.mcap", "a_4.mcap", "a_5.mcap"]),
        (["a_1.db3", "a_3.db3", "b_0.mcap"], ["a_2.db3"]),
        (["a_0.mcap", "a_1.mcap"], []),
        (["a_7.mcap", "a_9.mcap"], []),
        (["drive_2024_05_01.mcap", "drive_2024_05_03.mcap"], []),
        (["drive_20240501.mcap", "drive_20240503.mcap", "x.mcap"], []),
    ],
)
def test_numbers_that_are_missing(names, missing):
    assert list(missing_numbers(Path(name) for name in names)) == missing
