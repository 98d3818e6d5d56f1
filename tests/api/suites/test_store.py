"""A store of runs: each is there whole or not at all, whatever fails."""

from pathlib import Path

import pytest

from fbench.api.suites import store as store_module
from fbench.api.suites.cells import is_sealed_run, seal_run
from fbench.api.suites.store import ResultStore, fetch_log, find_logs, log_place
from fbench.replay.contracts.errors import ConfigError, OutputError

pytest.importorskip("fsspec", reason="needs the extra `cluster`")


@pytest.fixture
def run(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "scores.json").write_text("[]")
    (folder / "tracks.parquet").write_bytes(b"PAR1")
    (folder / "lockstep").mkdir()
    (folder / "lockstep/scores.json").write_text("[2]")
    seal_run(folder, "k1", {"log": "x"})
    return folder


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch):
    monkeypatch.setattr(store_module, "_PAUSE_S", 0.0)


def files(folder):
    every = (file for file in sorted(folder.rglob("*")) if file.is_file())
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in every}


def test_what_was_put_is_fetched_byte_for_byte(tmp_path, run):
    store = ResultStore(f"file://{tmp_path}/store")
    store.put("k1", run)
    assert store.fetch("k1", tmp_path / "again")
    assert files(tmp_path / "again") == files(run)
    assert "lockstep/scores.json" in files(run)
    assert not store.fetch("k2", tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_what_is_damaged_in_the_store_is_not_fetched(tmp_path, run):
    store = ResultStore(f"file://{tmp_path}/store")
    store.put("k1", run)
    (tmp_path / "store/k1/scores.json").write_text("[1]")
    assert not store.fetch("k1", tmp_path / "again")
    for evil in ("../../evil", "../evil", "a/../evil", "/evil", "a/b/c"):
        (tmp_path / "store/k1/cell.json").write_text(f'{{"key": "k1", "files": {{"{evil}": "0"}}}}')
        assert not store.fetch("k1", tmp_path / "again")
    assert not (tmp_path / "again").exists()


class Flaky:
    """A store's file system of which some calls fail."""

    def __init__(self, place, failing):
        self._place, self._failing, self.num = place, failing, 0

    def __getattr__(self, name):
        def call(*args, **kwargs):
            self.num += 1
            if self.num in self._failing:
                raise OSError(f"no answer to call {self.num}")
            return getattr(self._place, name)(*args, **kwargs)

        return call


@pytest.mark.parametrize("failing", [{number} for number in range(1, 8)] + [{1, 3, 5}])
def test_a_store_that_fails_now_and_then_is_tried_again(tmp_path, run, monkeypatch, failing):
    store = ResultStore(f"file://{tmp_path}/store")
    monkeypatch.setattr(store, "_place", Flaky(store._place, failing))
    store.put("k1", run)
    assert store.fetch("k1", tmp_path / "again")
    assert is_sealed_run(tmp_path / "again", "k1")


def test_a_store_that_keeps_failing_holds_no_half_of_a_run(tmp_path, run, monkeypatch):
    store = ResultStore(f"file://{tmp_path}/store")
    whole = store._place
    monkeypatch.setattr(store, "_place", Flaky(whole, set(range(4, 1000))))
    with pytest.raises(OutputError, match=r"store file://.*fails"):
        store.put("k1", run)
    monkeypatch.setattr(store, "_place", whole)
    assert not store.fetch("k1", tmp_path / "again")
    store.put("k1", run)
    assert store.fetch("k1", tmp_path / "again")


def test_logs_by_address_are_found_and_fetched_when_they_changed(tmp_path, monkeypatch):
    monkeypatch.setenv("FBENCH_CACHE", str(tmp_path / "cache"))
    for name in ("b.mcap", "a.mcap"):
        (tmp_path / name).write_bytes(name.encode())
    urls = find_logs(f"file://{tmp_path}/*.mcap")
    assert [url.rpartition("/")[2] for url in urls] == ["a.mcap", "b.mcap"]
    here = fetch_log(urls[0], log_place(urls[0]))
    assert (here.name, here.read_bytes()) == ("a.mcap", b"a.mcap")
    (tmp_path / "a.mcap").write_bytes(b"longer than before")
    assert fetch_log(urls[0], log_place(urls[0])).read_bytes() == b"longer than before"
    assert fetch_log("memory://no/such.mcap", tmp_path / "b.mcap") == tmp_path / "b.mcap"


@pytest.mark.parametrize("url", ["file:///no/such.mcap", "file:///no/*.mcap", "nonsense://a.mcap"])
def test_what_is_not_there_is_one_line(url):
    with pytest.raises(ConfigError) as raised:
        find_logs(url)
    assert "\n" not in str(raised.value)


def test_no_password_of_a_store_is_told():
    with pytest.raises(ConfigError) as raised:
        ResultStore("nonsense://me:secret@host/bucket")
    assert "secret" not in str(raised.value)


def test_paths_are_no_addresses():
    assert store_module.is_url("s3://bucket/a.mcap")
    assert not store_module.is_url(str(Path("a") / "b.mcap"))
