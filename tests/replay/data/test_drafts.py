"""Drafts: one writer at a time, nothing half written under its own name, nothing lost by a kill."""

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.files import Draft

HOLD = """
import sys, time
from pathlib import Path
from fbench.replay.data.files import Draft
draft = Draft(Path(sys.argv[1]), is_folder=sys.argv[2] == "folder")
place = draft.path / "half" if draft.path.is_dir() else draft.path
place.write_text("half")
print("held", flush=True)
time.sleep(60)
"""


def fill(draft: Draft, text: str) -> None:
    place = draft.path / "a.txt" if draft.path.is_dir() else draft.path
    place.write_text(text)


def content(target: Path) -> str:
    return (target / "a.txt" if target.is_dir() else target).read_text()


@pytest.fixture(params=[False, True], ids=["file", "folder"])
def is_folder(request: pytest.FixtureRequest) -> bool:
    return bool(request.param)


def test_nothing_has_the_name_before_publish_and_nothing_is_left_beside_it(tmp_path, is_folder):
    target = tmp_path / "new" / "a"
    with Draft(target, is_folder) as draft:
        fill(draft, "whole")
        assert not target.exists()
        draft.publish()
    assert content(target) == "whole"
    assert os.listdir(target.parent) == ["a"]


def test_what_is_there_stays_until_it_is_replaced(tmp_path, is_folder):
    target = tmp_path / "a"
    for text in ("first", "second"):
        with Draft(target, is_folder) as draft:
            fill(draft, text)
            assert not target.exists() or content(target) == "first"
            draft.publish()
    with Draft(target, is_folder) as draft:
        fill(draft, "given up")
    assert content(target) == "second"
    assert os.listdir(tmp_path) == ["a"]


def test_a_second_writer_is_refused_and_the_first_goes_on(tmp_path, is_folder):
    target = tmp_path / "a"
    with Draft(target, is_folder) as draft:
        fill(draft, "first")
        for kind in (False, True):
            with pytest.raises(ConfigError, match="a: another process is writing it; try again when it has finished"):
                Draft(target, kind)
        draft.publish()
    assert content(target) == "first"


@pytest.mark.parametrize("killed", ["file", "folder"])
def test_a_killed_writer_blocks_nobody(tmp_path, is_folder, killed):
    target = tmp_path / "a"
    command = [sys.executable, "-c", HOLD, str(target), killed]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "held\n"
        with pytest.raises(ConfigError):
            Draft(target, is_folder)
        child.send_signal(signal.SIGKILL)
    with Draft(target, is_folder) as draft:
        assert not (os.listdir(draft.path) if is_folder else draft.path.read_bytes())
        fill(draft, "next")
        draft.publish()
    assert content(target) == "next"
    assert os.listdir(tmp_path) == ["a"]


def test_a_folder_that_a_killed_writer_was_replacing_comes_back(tmp_path):
    old = tmp_path / ".a.partial.old"
    old.mkdir()
    (old / "a.txt").write_text("finished")
    Draft(tmp_path / "a", is_folder=True).discard()
    assert content(tmp_path / "a") == "finished"
    assert os.listdir(tmp_path) == ["a"]


def test_many_writers_of_one_target_never_mix(tmp_path):
    code = """
import sys
from pathlib import Path
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.files import Draft
for i in range(150):
    try:
        with Draft(Path(sys.argv[1]), is_folder=True) as draft:
            for name in "abc":
                (draft.path / name).write_text(f"{sys.argv[2]} {i}")
            draft.publish()
    except ConfigError:
        pass
"""
    target = tmp_path / "t"
    children = [subprocess.Popen([sys.executable, "-c", code, str(target), name]) for name in "xyz"]
    assert [child.wait(timeout=60) for child in children] == [0, 0, 0]
    assert len({(target / name).read_text() for name in "abc"}) == 1
    assert sorted(os.listdir(target)) == ["a", "b", "c"]
    assert os.listdir(tmp_path) == ["t"]


def test_a_link_in_the_place_of_a_draft_is_not_followed(tmp_path):
    (tmp_path / "other").write_text("kept")
    (tmp_path / ".a.partial").symlink_to(tmp_path / "other")
    with pytest.raises(ConfigError, match="symbolic"):
        Draft(tmp_path / "a")
    assert (tmp_path / "other").read_text() == "kept"


@pytest.mark.parametrize(
    ("number", "code"), [(errno.ENOTDIR, 2), (errno.ENOSPC, 3), (errno.EROFS, 3), (errno.EACCES, 3)]
)
def test_a_wrong_place_is_a_usage_error_and_a_full_disk_is_not(tmp_path, monkeypatch, number, code):
    draft = Draft(tmp_path / "a")

    def refuse(*_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(ConfigError, match=rf"a: can't be written \({os.strerror(number)}\)$") as caught, draft:
        draft.publish()
    assert caught.value.exit_code == code
    assert not list(tmp_path.iterdir())
