import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.datasets.importing.toy import Toy, ToyParams, ToyRecording, write_toy

from fbench.datasets.importing.run import NUM_AHEAD, claim, import_one, import_recordings, read_ahead
from fbench.replay.contracts.errors import ConfigError, FbenchError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.importing import BadInput, FrameRange, ImportRequest, choose_names
from fbench.replay.contracts.testing import check_importer
from fbench.replay.data.messages import Image, PointCloud, RadarScan
from fbench.replay.data.rig import LogInfo, Mount, Rig
from fbench.replay.logs.convert.target import Target
from fbench.replay.logs.open import open_log

RIG = Rig({"lidar": Mount("lidar", np.zeros(3), np.array([0.0, 0, 0, 1]))}, {})


def cloud(log_ns, stamp_ns=None, sensor="lidar"):
    return PointCloud(sensor, log_ns if stamp_ns is None else stamp_ns, log_ns, np.zeros((1, 3), np.float32))


class Fixed:
    """Importer, recording and everything: gives the items that it was made with."""

    name, num_items, rig = "fixed", 1, RIG
    info = LogInfo("fixed", "fixed-1", {"dataset": "fixed", "licence": "none"})

    def __init__(self, *items):
        self._items = items

    def names(self, source):
        return ["fixed"]

    def recordings(self, source, asked):
        yield self

    def items(self):
        yield from self._items

    def summary(self):
        return ["found: something"]


@pytest.mark.parametrize(
    ("items", "message"),
    [
        ([cloud(5), cloud(4)], r"^fixed: its importer gives PointCloud of 'lidar' of 4 ns after something of 5$"),
        ([cloud(-1)], r"^fixed: PointCloud of 'lidar' at -1 ns, recorded at -1: outside 0 to 2\^63 - 1$"),
        ([cloud(5, 2**63)], r"outside 0 to"),
        ([cloud(5, sensor="top")], r"^fixed: PointCloud of 'top' comes from a lidar that the rig lacks$"),
        ([RadarScan("lidar", 1, 1, np.zeros((0, 3), np.float32))], r"comes from a radar that the rig lacks$"),
        ([Image("lidar", 1, 1, b"", "jpeg", (1, 1))], r"comes from a camera that the rig lacks$"),
        ([3], r"^fixed: its importer gives int, which no log can hold$"),
        ([], r"^fixed: nothing in it to import, are --frames outside of it\?$"),
    ],
)
def test_what_no_log_can_hold(tmp_path, items, message):
    for name in ("a.mcap", "a.parquet"):
        with pytest.raises(LogError, match=message):
            import_one(Fixed(*items), tmp_path, tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_the_thread_that_reads_ahead_ends_before_an_error_is_told(tmp_path):
    with pytest.raises(LogError) as error:
        import_one(Fixed(cloud(5), cloud(4), cloud(6), cloud(7)), tmp_path, tmp_path / "a.mcap")
    assert error.tb is not None  # which still holds all that was open then
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("fbench-import")]


def test_one_sequence_is_expected(tmp_path):
    write_toy(tmp_path / "src", ["a", "b"])
    with pytest.raises(ConfigError, match=r"src: expected one sequence, there are 2$"):
        import_one(Toy(), tmp_path / "src", tmp_path / "a.mcap")
    log = import_one(Toy(ToyParams(2.0)), tmp_path / "src", tmp_path / "b.mcap", ImportRequest(("b",)))
    assert (log.name, log.state, log.lines[0]) == ("b", "written", "sweeps: 4")
    first = next(iter(open_log(log.path, FaultLog()).messages()))
    raw = np.frombuffer((tmp_path / "src/b/000.bin").read_bytes(), np.float32).reshape(-1, 3)
    np.testing.assert_array_equal(first.xyz, raw * 2)


def test_buffers_that_an_importer_fills_again_stay_as_they_were(tmp_path):
    write_toy(tmp_path / "src", ["a"], num_sweeps=20)

    class ReusingRecording(ToyRecording):
        def items(self):
            buffer = np.zeros((100, 3), np.float32)
            for cloud in super().items():
                buffer[:] = cloud.xyz
                yield replace(cloud, xyz=buffer)

    class Reusing(Toy):
        def recordings(self, source, asked):
            yield ReusingRecording("a", source / "a", asked, ToyParams())

    import_one(Toy(), tmp_path / "src", tmp_path / "fresh.mcap")
    import_one(Reusing(), tmp_path / "src", tmp_path / "reused.mcap")
    assert (tmp_path / "reused.mcap").read_bytes() == (tmp_path / "fresh.mcap").read_bytes()


@pytest.mark.parametrize("given", [["a", "z"], ["a", "a"], ["a"]])
def test_sequences_that_are_not_those_that_were_wanted(tmp_path, given):
    write_toy(tmp_path / "src", ["a", "b", "z"])

    class Other(Toy):
        def recordings(self, source, asked):
            return super().recordings(source, ImportRequest(tuple(given)))

    targets = {name: Target(tmp_path / f"{name}.mcap") for name in "ab"}
    with pytest.raises(LogError, match=r"isn't wanted|left out 'b'"):
        list(import_recordings(Other(), tmp_path / "src", ImportRequest(("a", "b")), targets))


def test_a_failure_between_sequences_is_that_of_those_to_come(tmp_path):
    write_toy(tmp_path / "src", ["a", "b", "c"])

    class Failing(Toy):
        def recordings(self, source, asked):
            yield next(super().recordings(source, asked))
            raise LogError("tables end here")

    targets = {name: Target(tmp_path / f"{name}.mcap") for name in "abc"}
    asked = ImportRequest(("a", "b", "c"), bad=BadInput(skip=True))
    logs = list(import_recordings(Failing(), tmp_path / "src", asked, targets))
    assert [(log.name, log.state) for log in logs] == [("a", "written"), ("b", "failed"), ("c", "failed")]
    assert (asked.bad.num, asked.bad.texts) == (1, ["tables end here"])
    again = {name: Target(tmp_path / f"{name}.parquet") for name in "abc"}
    with pytest.raises(LogError, match=r"^tables end here$"):
        list(import_recordings(Failing(), tmp_path / "src", ImportRequest(("a", "b", "c")), again))


def test_an_importer_may_hold_something_while_it_is_used(tmp_path):
    write_toy(tmp_path / "src", ["a", "b"])
    (tmp_path / "src/b/000.bin").write_bytes(b"short")
    events = []

    class Holding(Toy):
        def recordings(self, source, asked):
            try:
                yield from super().recordings(source, asked)
            finally:
                events.append("given back")

    targets = {name: Target(tmp_path / f"{name}.mcap") for name in "ab"}
    with pytest.raises(LogError, match=r"b/000.bin: 5 bytes") as caught:
        list(import_recordings(Holding(), tmp_path / "src", ImportRequest(("a", "b")), targets))
    assert caught.tb is not None
    assert events == ["given back"]


@pytest.mark.parametrize("name", ["a.mcap", "a.parquet"])
def test_who_writes_the_same_log_waits(tmp_path, name):
    write_toy(tmp_path / "src", ["a"])
    out, waits, logs = tmp_path / name, threading.Event(), []

    def tell(text, done, total):
        if "waiting" in text:
            waits.set()

    def run():
        asked = ImportRequest(("a",))
        logs.extend(import_recordings(Toy(), tmp_path / "src", asked, {"a": Target(out)}, tell))

    with claim(out, lambda: pytest.fail("nobody else has it")):
        thread = threading.Thread(target=run)
        thread.start()
        assert waits.wait(20)
        assert not out.exists()
    thread.join()
    assert [log.state for log in logs] == ["written"]
    assert sorted(path.name for path in tmp_path.iterdir()) == [name, "src"]


@pytest.mark.parametrize("kind", ["file", "folder"])
@pytest.mark.parametrize("form", ["mcap", "parquet"])
def test_what_killed_imports_left_is_cleared_away(tmp_path, form, kind):
    write_toy(tmp_path / "src", ["a"])
    out = tmp_path / f"a.{form}"
    left = out.with_name(f".{out.name}.partial")
    if kind == "file":
        left.write_bytes(b"half")
    else:
        left.mkdir()
        (left / "x.parquet").touch()
    out.with_name(f".{out.name}.importing").touch()
    assert import_one(Toy(), tmp_path / "src", out).state == "written"
    assert sorted(path.name for path in tmp_path.iterdir()) == [out.name, "src"]


def test_a_log_that_was_being_replaced_gets_its_name_back(tmp_path):
    write_toy(tmp_path / "src", ["a"])
    out = tmp_path / "a.parquet"
    import_one(Toy(), tmp_path / "src", out)
    out.rename(tmp_path / ".a.parquet.partial.old")
    logs = list(import_recordings(Toy(), tmp_path / "src", ImportRequest(("a",)), {"a": Target(out)}))
    assert [log.state for log in logs] == ["there"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.parquet", "src"]


def test_folders_that_are_not_there_are_made(tmp_path):
    write_toy(tmp_path / "src", ["a"])
    assert import_one(Toy(), tmp_path / "src", tmp_path / "new/folder/a.mcap").state == "written"
    with pytest.raises(ConfigError, match=r"a.mcap/b.mcap: can't be written \(.+\)"):
        import_one(Toy(), tmp_path / "src", tmp_path / "new/folder/a.mcap/b.mcap")


def test_patterns():
    names = ("scene-1", "scene-2", "other")
    assert choose_names(names, []) == names
    assert choose_names(names, ["other", "scene-?"]) == names
    assert choose_names(names, ["*-2"]) == ("scene-2",)
    with pytest.raises(ConfigError, match=r"^--scenes scene-3: no such sequence; did you mean 'scene-2'\?$"):
        choose_names(names, ["scene-1", "scene-3"])
    with pytest.raises(ConfigError, match=r"no such sequence; there are 900, 0 to 899$"):
        choose_names([str(i) for i in range(900)], ["x" * 20])


def test_an_importer_that_conforms(tmp_path):
    check_importer(Toy, write_toy(tmp_path, ["a", "b"]))


class NoOrder(Toy):
    def recordings(self, source, asked):
        return reversed(list(super().recordings(source, asked)))


class NoFrames(Toy):
    def recordings(self, source, asked):
        return super().recordings(source, ImportRequest(asked.names, FrameRange()))


class Another(Toy):
    num = 0

    def __init__(self):
        type(self).num += 1
        super().__init__(ToyParams(self.num))


class Forgets(Toy):
    num = 0

    def recordings(self, source, asked):
        type(self).num += 1
        return iter(list(super().recordings(source, asked))[: 2 if self.num == 1 else 1])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (Forgets, "recordings\\(\\) gives \\['a'\\], wanted"),
        (NoOrder, "recordings\\(\\) gives \\['b', 'a'\\], wanted"),
        (NoFrames, "a: gives frames \\[2, 3\\] where 0:2 are wanted"),
        (Another, "a: is another the second time"),
        (lambda: Fixed(cloud(5), cloud(4)), "of 4 ns after something of 5"),
        (lambda: Fixed(*map(cloud, range(100))), "fixed: num_items says 1, there are 100"),
    ],
)
def test_importers_that_do_not_conform(tmp_path: Path, make, message):
    write_toy(tmp_path, ["a", "b"])
    with pytest.raises((AssertionError, FbenchError), match=message):
        check_importer(make, tmp_path)


def test_the_same_items_in_the_same_order():
    assert list(read_ahead(iter(range(100)))) == list(range(100))
    assert list(read_ahead(iter([]))) == []


def test_no_more_than_so_many_are_taken_before_they_are_wanted():
    taken = []

    def numbers():
        for i in range(100):
            taken.append(i)
            yield i

    items = read_ahead(numbers())
    assert next(items) == 0
    items.close()
    assert len(taken) <= NUM_AHEAD + 1


def test_an_error_comes_where_its_item_would_have():
    def broken():
        yield 1
        yield 2
        raise ValueError("here")

    items = read_ahead(broken())
    assert [next(items), next(items)] == [1, 2]
    with pytest.raises(ValueError, match="here"):
        next(items)


def test_one_thread_asks_for_all_and_ends_with_the_iteration():
    names = list(read_ahead(threading.current_thread().name for _ in range(10)))
    assert len(set(names)) == 1
    assert names[0] != threading.current_thread().name
    assert names[0] not in [thread.name for thread in threading.enumerate()]
