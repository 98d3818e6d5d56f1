"""Where a converted log may go, and that nothing is left behind where something goes wrong."""

import resource
import signal

import pytest
from tests.replay.logs import builders as b
from tests.replay.logs.convert.helpers import content, conversion, converted, digest, messages
from tests.replay.logs.other_forms import chunks

from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.logs.convert.run import ConvertRequest, convert
from fbench.replay.logs.convert.target import Target
from fbench.replay.logs.open import open_container

HOWS = [("out.mcap", {}), ("out.parquet", {}), ("parts", {"split_s": 0.5})]


@pytest.mark.parametrize("name", ["out", "out.bag", "out.db3", "out.MCAP", ".mcap"])
def test_names_of_no_form(tmp_path, drive, name):
    with pytest.raises(ConfigError, match=r"which form\? A name with .mcap is an MCAP file, with .parquet a Parquet"):
        converted(drive, tmp_path / name)


@pytest.mark.parametrize(
    ("name", "how", "message"),
    [
        ("out.mcap", {"compression": "gzip"}, "compression 'gzip': choose one of zstd, lz4, none"),
        ("out.mcap", {"compression": "snappy"}, "compression 'snappy': choose one of zstd, lz4, none"),
        ("out.parquet", {"compression": "lz4"}, "compression 'lz4': choose one of zstd, snappy, none"),
        ("out.mcap", {"chunk_size": 0}, "--chunk-size 0: expected 1 to 134217728 bytes"),
        ("out.mcap", {"chunk_size": 2**40}, "--chunk-size 1099511627776: expected 1 to"),
        ("out.parquet", {"chunk_size": 1000}, "--chunk-size is for MCAP, not for Parquet"),
        ("out.mcap", {"rows_per_group": 10}, "--rows-per-group is for Parquet, not for MCAP"),
        ("out.parquet", {"rows_per_group": 0}, "rows_per_group 0: must be at least 1"),
        ("parts", {"split_s": 1, "compression": "gzip"}, "compression 'gzip'"),
    ],
)
def test_options_that_cannot_be(tmp_path, drive, name, how, message):
    with pytest.raises(ConfigError, match=message):
        converted(drive, tmp_path / name, **how)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("name", "how"), HOWS)
def test_parent_folders_are_made_where_that_is_possible(tmp_path, drive, name, how):
    assert digest(converted(drive, tmp_path / "new" / "folder" / name, **how)) == digest(drive)
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match=rf"file/{name}: can't be written \(Not a directory\)"):
        converted(drive, tmp_path / "file" / name, **how)


@pytest.mark.parametrize(("name", "how"), HOWS)
def test_a_log_that_exists_is_replaced_only_on_request(tmp_path, drive, name, how):
    out = converted(drive, tmp_path / name, **how)
    before = digest(out)
    small = b.write(tmp_path / "small.mcap", b.sequence(3))
    with pytest.raises(ConfigError, match="exists already; choose another with --out, or --overwrite it"):
        converted(small, out, **how)
    assert digest(out) == before
    converted(small, out, overwrite=True, **how)
    assert digest(out) == digest(small)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([name, "small.mcap"])


@pytest.mark.parametrize(("name", "how"), HOWS)
def test_the_source_is_never_replaced(tmp_path, drive, name, how):
    source = converted(drive, tmp_path / name, **how)
    inside = next(iter(sorted(source.iterdir()))) if source.is_dir() else source
    link = tmp_path / f"link{source.suffix}"
    link.symlink_to(source)
    for path, out in [(source, source), (inside, source), (source, link), (link, source)]:
        if path.suffix == ".parquet" and path.is_file():
            continue  # a file of a log isn't one
        with pytest.raises(ConfigError, match="is the log that is converted, or lies in it"):
            converted(path, out, overwrite=True, **how)
    if source.is_dir():
        with pytest.raises(ConfigError, match="is the log that is converted, or lies in it"):
            converted(source, source / "new.mcap")
    assert digest(source) == digest(drive)


@pytest.mark.parametrize(("name", "how"), HOWS)
def test_what_is_no_log_is_not_replaced(tmp_path, drive, name, how):
    out = tmp_path / name
    out.mkdir()
    (out / "thesis.txt").write_text("mine")
    with pytest.raises(ConfigError, match="exists and isn't a"):
        converted(drive, out, overwrite=True, **how)
    assert (out / "thesis.txt").read_text() == "mine"
    assert [p.name for p in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize(
    ("name", "how"), [*HOWS, ("out.mcap", {"chunk_size": 700}), ("out.parquet", {"rows_per_group": 1})]
)
def test_a_full_disk_leaves_nothing(tmp_path, name, how):
    path = b.write(tmp_path / "log.mcap", b.sequence(60, points=500), b.the_rig())
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
        with pytest.raises(ConfigError, match=f"{name}.*can't be written .*File too large"):
            converted(path, tmp_path / name, compression="none", **how)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert [p.name for p in tmp_path.iterdir()] == ["log.mcap"]


@pytest.mark.parametrize("name", ["out.mcap", "out.parquet"])
def test_an_interruption_leaves_nothing_and_the_old_log_in_its_place(tmp_path, drive, name):
    out = converted(drive, tmp_path / name)
    before = digest(out)

    def stop(num_messages):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        convert(open_container(drive, FaultLog()), Target(out, overwrite=True), ConvertRequest((), Excerpt()), stop)
    assert [p.name for p in tmp_path.iterdir()] == [name]
    assert digest(out) == before


@pytest.mark.parametrize("name", ["out.mcap", "out.parquet"])
def test_damage_is_counted_and_the_rest_is_written(tmp_path, drive, name):
    data = bytearray(drive.read_bytes())
    at, length = chunks(bytes(data))[3]
    data[at + length // 2] ^= 1
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data)
    result, faults = conversion(path, tmp_path / name)
    assert dict(faults.counts) == {"LOG004": 1}
    assert sum(result.messages.values()) < len(messages(drive))
    assert content(result.path)[-1] == content(path)[-1]


@pytest.mark.parametrize("name", ["out.mcap", "out.parquet"])
def test_a_truncated_log_is_written_up_to_there(tmp_path, drive, name):
    path = tmp_path / "cut.mcap"
    path.write_bytes(drive.read_bytes()[:30_000])
    result, faults = conversion(path, tmp_path / name)
    assert faults.counts["LOG002"] == 1
    assert messages(converted(result.path, tmp_path / "back.mcap")) == messages(path)


def test_a_damaged_row_group_is_counted(tmp_path, drive):
    there = converted(drive, tmp_path / "drive.parquet", rows_per_group=4)
    file = there / "top.points.parquet"
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    result, faults = conversion(there, tmp_path / "out.mcap")
    assert faults.counts["PQ002"] == 1
    assert result.messages["/top/points"] == 36


def test_sources_that_are_no_logs(tmp_path):
    (tmp_path / "text.mcap").write_text("hello")
    (tmp_path / "lfs.mcap").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 9\n")
    (tmp_path / "empty").mkdir()
    for name, message in [
        ("text.mcap", "looks like text"), ("lfs.mcap", "a pointer of Git LFS; get the file with `git lfs pull`"),
        ("no.mcap", "No such file"), ("empty", "no log"),
    ]:  # fmt: skip
        with pytest.raises(LogError, match=message):
            converted(tmp_path / name, tmp_path / "out.mcap")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["empty", "lfs.mcap", "text.mcap"]
