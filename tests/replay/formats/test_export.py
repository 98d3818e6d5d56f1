"""What may be written where, and that nothing is left where an export fails."""

import pytest
from tests.replay.formats.exports import exported, run_of, solids, stamp, sweeps, write_log

from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Truth


@pytest.fixture
def log(tmp_path):
    truths = [Truth(stamp(i), stamp(i), solids([10.0], source_label=["Car"], track_id=[1]), None, i) for i in range(2)]
    return write_log(tmp_path / "a.mcap", [*sweeps(2, [0, 1]), *truths])


def names(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def test_one_file_a_sequence(tmp_path, log):
    other = write_log(tmp_path / "b.mcap", [Truth(stamp(0), stamp(0), solids([9.0], track_id=[1]), None, 0)])
    exported("kitti-tracking", tmp_path / "tracking", log, other)
    assert names(tmp_path / "tracking") == ["a.txt", "b.txt"]
    exported("kitti", tmp_path / "object", log, other)
    assert names(tmp_path / "object") == ["a", "a/000000.txt", "a/000001.txt", "b", "b/000000.txt"]
    exported("mot", tmp_path / "mot", log)
    assert names(tmp_path / "mot") == ["a", "a/gt", "a/gt/gt.txt", "a/seqinfo.ini"]


def test_the_same_bytes_again(tmp_path, log):
    for form in ("kitti", "kitti-tracking", "mot"):
        for out in ("x", "y"):
            exported(form, tmp_path / f"{form}-{out}", log)
        files = [{p.name: p.read_bytes() for p in (tmp_path / f"{form}-{o}").rglob("*") if p.is_file()} for o in "xy"]
        assert files[0] == files[1] != {}


def test_a_name_for_one(tmp_path, log):
    exported("kitti-tracking", tmp_path / "out", log, name="0003")
    assert names(tmp_path / "out") == ["0003.txt"]
    exported("kitti-tracking", tmp_path / "odd", log, name="../b/c d")
    assert names(tmp_path / "odd") == ["_._b_c_d.txt"]
    exported("kitti-tracking", tmp_path / "long", log, name="x" * 300)
    assert [len(name) for name in names(tmp_path / "long")] == [184]
    with pytest.raises(ConfigError, match="--name x: is for one source, there are 2"):
        exported("kitti-tracking", tmp_path / "two", log, log, name="x")


def test_two_of_one_name(tmp_path, log):
    (tmp_path / "other").mkdir()
    twin = tmp_path / "other" / "a.mcap"
    twin.write_bytes(log.read_bytes())
    with pytest.raises(ConfigError, match=r"is called 'a' like .*a\.mcap; export one of them on its own"):
        exported("kitti-tracking", tmp_path / "out", log, twin)
    assert not (tmp_path / "out").exists()


def test_what_is_there_stays_unless_it_is_an_export(tmp_path, log):
    out = tmp_path / "out"
    out.mkdir()
    exported("kitti-tracking", out, log)  # an empty folder is nothing
    (out / "old.txt").write_text("")
    with pytest.raises(ConfigError, match="out: exists already; choose another with --out, or --overwrite it"):
        exported("kitti-tracking", out, log)
    exported("kitti-tracking", out, log, overwrite=True)
    assert names(out) == ["a.txt"]
    (out / "thesis.pdf").write_text("")
    with pytest.raises(ConfigError, match="exists and holds more than an export, so --overwrite doesn't touch it"):
        exported("kitti-tracking", out, log, overwrite=True)
    assert names(out) == ["a.txt", "thesis.pdf"]


def test_links_are_not_followed(tmp_path, log):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    for overwrite in (False, True):
        with pytest.raises(ConfigError):
            exported("kitti-tracking", tmp_path / "link", log, overwrite=overwrite)
    assert names(tmp_path / "real") == []


@pytest.mark.parametrize("out", ["a.mcap", ".", "run-a", "run-a/out"])
def test_sources_are_not_overwritten(tmp_path, log, out):
    run = run_of(log, lambda i: solids([10.0], track_id=[1]))
    with pytest.raises(ConfigError, match="is what is exported, or lies in it or around it"):
        exported("kitti-tracking", tmp_path / out, log, run, overwrite=True)


def test_a_submission_is_a_json_file(tmp_path, log):
    with pytest.raises(ConfigError, match=r"this format is one file; expected a name that ends in \.json"):
        exported("nuscenes", tmp_path / "out", log)
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match=r"can't be written \(Not a directory"):
        exported("kitti", tmp_path / "file" / "out", log)
    (tmp_path / "x.json").mkdir()
    with pytest.raises(ConfigError, match=r"x\.json: exists"):
        exported("nuscenes", tmp_path / "x.json", log, overwrite=True)


def test_nothing_is_left_of_an_export_that_fails(tmp_path, log):
    bad = write_log(tmp_path / "b.mcap", [Truth(stamp(0), stamp(0), Boxes3D.empty(), None, 0)])
    run = run_of(write_log(tmp_path / "c.mcap", sweeps(1)), lambda i: solids([5.0]))
    before = names(tmp_path)
    with pytest.raises(LogError, match="no track ids"):
        exported("kitti-tracking", tmp_path / "out", log, bad, run)
    assert names(tmp_path) == before
