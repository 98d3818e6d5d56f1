"""`fbench log import`, as a user calls it."""

import json
import os
import pty
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tests.datasets.importing import toy
from tests.datasets.importing.toy import write_toy

TOY = f"{toy.__file__}:Toy"
FIVE = ["a", "b", "c", "d", "e"]
MAIN = "from fbench.cli import main; main()"
COMMAND = [sys.executable, "-c", MAIN, "log", "import", TOY]


@pytest.fixture
def source(tmp_path):
    return write_toy(tmp_path / "src", FIVE)


@pytest.fixture
def toys(fbench):
    """Import `src` with further arguments."""
    return lambda *args: fbench("log", "import", TOY, "src", *args)


def content(folder):
    """All files below a folder, hidden ones too."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(Path(folder).rglob("*")) if p.is_file()}


@pytest.mark.slow
def test_import_into_parquet_is_the_same_log(fbench, shared):
    for name in ("a.mcap", "a.parquet"):
        assert fbench("log", "import", "astyx", shared / "data" / "astyx", "-o", name).code == 0
        assert fbench("replay", name, "-p", "radar3d", "-o", f"{name}-run").code == 0
    runs = [json.loads(Path(f"{name}-run/manifest.json").read_text()) for name in ("a.mcap", "a.parquet")]
    assert runs[0]["log"]["digest"] == runs[1]["log"]["digest"]
    assert runs[0]["digest"] == runs[1]["digest"]


@pytest.mark.parametrize("form", ["mcap", "parquet"])
def test_a_log_a_sequence(toys, source, form):
    result = toys("-o", "logs/all", "--form", form)
    assert (result.code, result.err) == (0, "")
    assert sorted(path.name for path in Path("logs/all").iterdir()) == [f"{name}.{form}" for name in FIVE]
    lines = result.out.splitlines()
    assert [line.split(", ")[0] for line in lines[:5]] == [f"{n}: logs/all/{n}.{form}: 4 messages" for n in FIVE]
    assert lines[5:7] == ["sweeps: 4", "stamps: invented at 10 Hz"]
    assert lines[7].startswith("logs: 5 written (")
    assert lines[7].endswith(" MB), 0 there already, 0 failed, in logs/all")
    assert len(lines) == 8


def test_one_sequence_is_one_log(toys, source):
    assert toys("-o", "one.mcap", "--scenes", "b").out.splitlines()[:-1] == ["sweeps: 4", "stamps: invented at 10 Hz"]
    assert toys("-o", "one.parquet", "--scenes", "b").code == 0
    assert sorted(path.name for path in Path().iterdir()) == ["one.mcap", "one.parquet", "src"]
    result = toys("-o", "two.mcap", "--scenes", "[ab]")
    assert result.code == 2
    assert result.err == (
        "fbench: two.mcap: 2 sequences don't fit into one log; choose one with --scenes, such as 'a', or give a "
        "folder\n"
    )


def test_lines_of_many_sequences_are_joined(toys, tmp_path):
    for i in range(30):
        write_toy(tmp_path / "src", [f"s{i:02d}"], num_sweeps=2 + i % 3)
    lines = toys("-o", "logs").out.splitlines()
    assert lines[0].startswith("s00: logs/s00.mcap: 2 messages, ")
    assert lines[30:32] == ["sweeps: 2..4", "stamps: invented at 10 Hz"]
    assert len(lines) == 33


def test_as_json(toys, source):
    (source / "b/001.bin").write_bytes(b"short")
    (source / "c/calibration").touch()
    result = toys("-o", "logs", "--skip-bad", "--json")
    assert result.code == 4
    logs = result.json()["logs"]
    assert [log["state"] for log in logs] == ["written", "written", "failed", "written", "written"]
    assert [log["skipped"] for log in logs] == [0, 1, 1, 0, 0]
    assert logs[1]["messages"] == {"/lidar/points": 3}
    assert logs[1]["summary"] == ["sweeps: 3", "stamps: invented at 10 Hz"]
    assert logs[1]["bytes"] == Path("logs/b.mcap").stat().st_size
    assert (logs[2]["bytes"], logs[2]["path"]) == (None, "logs/c.mcap")
    assert result.json()["skipped"] == 2
    assert result.json()["first_skipped"][1] == "src/c/calibration: can't be understood"


def test_bad_input_ends_the_import_unless_it_is_skipped(toys, source):
    (source / "b/001.bin").write_bytes(b"short")
    (source / "c/calibration").touch()
    line = "src/b/001.bin: 5 bytes aren't whole rows of 3 float32, is it truncated?"
    result = toys("-o", "logs")
    assert (result.code, result.err) == (3, f"fbench: {line}\n")
    assert sorted(content("logs")) == ["a.mcap"]
    result = toys("-o", "logs", "--skip-bad")
    assert result.code == 4
    lines = result.out.splitlines()
    assert lines[0] == "a: logs/a.mcap is there already, made the same way"
    assert lines[1].endswith(" MB, 1 skipped")
    assert lines[2] == "c: logs/c.mcap isn't written, 1 skipped"
    assert "sweeps: 3..4" in lines
    assert lines[-3:-1] == [f"skipped: {line}", "skipped: src/c/calibration: can't be understood"]
    assert lines[-1].endswith("1 there already, 1 failed, in logs")
    assert sorted(content("logs")) == [f"{name}.mcap" for name in "abde"]
    result = toys("-o", "logs", "--scenes", "b")
    assert result.code == 2
    assert result.err.startswith("fbench: logs/b.mcap: exists already, imported with --skip-bad; say that again, or")


def test_where_nothing_can_be_used(toys, source):
    (source / "c/calibration").touch()
    assert toys("-o", "c.mcap", "--scenes", "c", "--skip-bad").code == 3
    assert not Path("c.mcap").exists()


@pytest.mark.parametrize("args", [("--frames", ":2"), ("--set", "scale=2")])
def test_another_import_is_not_taken_for_this_one(toys, source, args):
    assert toys("-o", "logs").code == 0
    before = content("logs")
    result = toys("-o", "logs", *args)
    assert result.code == 2
    assert result.err == (
        "fbench: logs/a.mcap: exists already, and is another log (other files, frames or parameters); choose another "
        "with --out, or --overwrite it\n"
    )
    assert content("logs") == before
    assert toys("-o", "logs", *args, "--overwrite").code == 0
    assert content("logs") != before
    assert toys("-o", "logs", *args).out.count("is there already") == 5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "form", "code"),
    [
        (signal.SIGKILL, "mcap", -signal.SIGKILL),
        (signal.SIGKILL, "parquet", -signal.SIGKILL),
        (signal.SIGTERM, "mcap", 143),
        (signal.SIGINT, "parquet", 130),
    ],
)
def test_an_interrupted_import_goes_on(toys, source, number, form, code):
    assert toys("-o", "whole", "--form", form).code == 0
    (source / "c/signal").write_text(str(int(number)))
    killed = subprocess.run([*COMMAND, "src", "-o", "logs", "--form", form], capture_output=True, text=True)
    assert killed.returncode == code
    assert "Traceback" not in killed.stderr
    assert sorted(p.name for p in Path("logs").iterdir() if not p.name.startswith(".")) == [f"a.{form}", f"b.{form}"]
    if number != signal.SIGKILL:
        assert len(list(Path("logs").iterdir())) == 2
    (source / "c/signal").unlink()
    result = toys("-o", "logs", "--form", form)
    assert result.code == 0
    assert result.out.count("is there already") == 2
    assert content("logs") == content("whole")


@pytest.mark.slow
def test_two_imports_at_once(toys, source):
    command = [*COMMAND, "src", "-o", "logs"]
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    results = [process.communicate() for process in both]
    assert [process.returncode for process in both] == [0, 0], results
    assert sum(out.count(" MB\n") for out, _ in results) == 5
    assert sum(out.count("is there already") for out, _ in results) == 5
    assert toys("-o", "whole").code == 0
    assert content("logs") == content("whole")


@pytest.mark.slow
@pytest.mark.parametrize("form", ["mcap", "parquet"])
def test_a_full_disk(tmp_path, form):
    write_toy(tmp_path / "src", ["a"], num_sweeps=40, num_points=10_000)
    limited = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (10**6, 10**6)); {MAIN}"
    command = [sys.executable, "-c", limited, *COMMAND[3:], "src", "-o", f"a.{form}"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (result.returncode, result.stdout) == (3, "")
    assert result.stderr.startswith(f"fbench: a.{form}: can't be written (")
    assert result.stderr.endswith("File too large)\n")
    assert [path.name for path in tmp_path.iterdir()] == ["src"]


@pytest.mark.slow
def test_a_bar_on_a_terminal_only(toys, source):
    read, write = pty.openpty()
    process = subprocess.Popen(
        [*COMMAND, "src", "-o", "logs"], stdout=subprocess.PIPE, stderr=write, text=True,
        env={**os.environ, "TERM": "xterm", "COLUMNS": "100"},
    )  # fmt: skip
    os.close(write)
    shown = b""
    while chunk := _read(read):
        shown += chunk
    out, _ = process.communicate()
    assert process.returncode == 0
    assert out == toys("-o", "other").out.replace("other", "logs")
    assert "\x1b" not in out
    text = shown.decode()
    assert "━" in text
    assert "5/5" in text
    assert "4/4" in text
    assert toys("-o", "third").err == ""


def _read(number):
    try:
        return os.read(number, 65536)
    except OSError:  # so a pseudo-terminal says that nobody writes to it any more
        return b""


@pytest.mark.parametrize(
    ("args", "code", "line"),
    [
        (("-o", "src"), 2, "src: is the dataset's own folder; choose another one for the logs"),
        (("-o", "file/a.parquet"), 2, "file/a.parquet: can't be written (Not a directory"),
        (("-o", "file"), 2, "file: is a file; expected a name that ends in .mcap or .parquet, or a folder"),
        (("-o", "file/logs"), 2, "file/logs: can't be written (Not a directory)"),
        (("-o", "/proc/logs"), 2, "/proc/logs: can't be written (No such file or directory)"),
        (("-o", "there.mcap", "--scenes", "a"), 2, "there.mcap: exists already; choose another with --out, or --over"),
        (("-o", "dir.mcap", "--scenes", "a", "--overwrite"), 2, "dir.mcap: exists and isn't a log of this form, so it"),
        (("-o", "o", "--scenes", "f*"), 2, "--scenes f*: no such sequence; there are: a, b, c, d, e"),
        (("-o", "o", "--frames", "9:3"), 2, "--frames 9:3: the range is empty"),
        (("-o", "o", "--frames", "100:"), 3, "a: nothing in it to import, are --frames outside of it?"),
        (("-o", "o", "--set", "scal=2"), 2, "unknown parameter 'scal'; did you mean 'scale'?"),
        (("-o", "o", "--detections", "d"), 2, "--detections d: the importer of "),
    ],
)
def test_what_cannot_be_is_one_line(toys, source, args, code, line):
    Path("file").touch()
    Path("there.mcap").write_text("something else")
    Path("dir.mcap").mkdir()
    before = content("src")
    result = toys(*args)
    assert (result.code, result.out, result.err.count("\n")) == (code, "", 1)
    assert result.err.startswith(f"fbench: {line}")
    assert content("src") == before
    assert Path("there.mcap").read_text() == "something else"


def test_a_folder_without_sequences(fbench):
    Path("src").mkdir()
    for out in ("a.mcap", "logs"):
        result = fbench("log", "import", TOY, "src", "-o", out)
        assert (result.code, result.err) == (3, f"fbench: src: no sequence of {TOY} in it\n")


def test_names_that_files_cannot_have(toys, tmp_path):
    write_toy(tmp_path / "src", ["a:b", "a_b", "A_B", "\x1b[31mred"])
    result = toys("-o", "logs")
    assert result.code == 0
    files = sorted(path.name for path in Path("logs").iterdir())
    assert len({name.casefold() for name in files}) == 4
    assert "__31mred.mcap" in files
    assert "\x1b" not in result.out
    before = content("logs")
    assert toys("-o", "logs", "--scenes", "a:b").out.count("is there already") == 1
    assert content("logs") == before


UNRULY = f"""
import sys
sys.path.insert(0, {str(Path(toy.__file__).parents[3])!r})
from tests.datasets.importing.toy import Toy, ToyRecording

class AtNames(Toy):
    def names(self, source): raise ZeroDivisionError("oh\\nno")

class NoNames(Toy):
    def names(self, source): return [1]

class TwoNames(Toy):
    def names(self, source): return ["a", "a"]

class AtRecordings(Toy):
    def recordings(self, source, asked): raise SystemExit(0)

class NoRecordings(Toy):
    def recordings(self, source, asked): return None

class Later(Toy):
    def recordings(self, source, asked):
        yield from list(super().recordings(source, asked))[:1]
        raise KeyError("b")

class Own(Toy):
    def recordings(self, source, asked):
        return [type(self).Recording(name, source / name, asked, self._params) for name in asked.names]

class AtInfo(Own):
    class Recording(ToyRecording):
        info = property(lambda self: 1 / 0)

class AtRig(Own):
    class Recording(ToyRecording):
        rig = property(lambda self: 1 / 0)

class AtNum(Own):
    class Recording(ToyRecording):
        num_items = property(lambda self: "many")

class AtItems(Own):
    class Recording(ToyRecording):
        def items(self):
            yield next(super().items())
            raise RecursionError("deep")

class AtSummary(Own):
    class Recording(ToyRecording):
        def summary(self): raise ValueError("what?")

class Empty: pass

class Half:
    def names(self, source): return ["a"]
"""


@pytest.mark.parametrize(
    ("cls", "code", "line"),
    [
        ("AtNames", 3, "can't name the sequences in src: ZeroDivisionError: oh (unruly.py:"),
        ("NoNames", 3, "can't name the sequences in src: int isn't a name"),
        ("TwoNames", 3, "can't name the sequences in src: 'a' is there twice"),
        ("AtRecordings", 3, "can't open a sequence in src: SystemExit: 0 (unruly.py:"),
        ("NoRecordings", 3, "can't open a sequence in src: TypeError: 'NoneType' object is not iterable"),
        ("Later", 3, "can't open a sequence in src: KeyError: 'b' (unruly.py:"),
        ("AtInfo", 3, "can't import 'a': ZeroDivisionError: "),
        ("AtRig", 3, "can't import 'a': ZeroDivisionError: "),
        ("AtNum", 3, "can't import 'a': ValueError: invalid literal for int()"),
        ("AtItems", 3, "can't import 'a': RecursionError: deep (unruly.py:"),
        ("AtSummary", 3, "can't import 'a': ValueError: what? (unruly.py:"),
        ("Empty", 2, "dataset 'unruly.py:Empty' isn't one: it lacks names(), recordings()"),
        ("Half", 2, "isn't one: it lacks recordings()"),
        ("Emty", 2, "unruly.py: has no class 'Emty'; did you mean 'Empty'?"),
    ],
)
def test_what_importers_raise_is_one_line(fbench, source, cls, code, line):
    Path("unruly.py").write_text(UNRULY)
    result = fbench("log", "import", f"unruly.py:{cls}", "src", "-o", "logs")
    assert (result.code, result.err.count("\n")) == (code, 1), result.err
    assert line in result.err
    left = sorted(content("logs")) if Path("logs").exists() else []
    assert left == (["a.mcap"] if cls in ("Later", "AtSummary") else [])


def test_parameters_of_an_importer_are_listed(fbench):
    result = fbench("plugins", "datasets", TOY)
    assert result.code == 0
    assert [line.split() for line in result.out.splitlines()] == [
        ["parameter", "default", "meaning"], ["scale", "1.0", "What", "coordinates", "are", "multiplied", "by."]
    ]  # fmt: skip
    assert fbench("plugins", "datasets", "astyx").out == "astyx takes no parameters\n"
    assert fbench("plugins", "metrics", "clear").code == 2


def test_results_of_others_where_the_importer_takes_none(fbench, tmp_path):
    result = fbench("log", "import", "radiate", tmp_path, "-o", tmp_path / "a.mcap", "--detections", "results")
    assert result.code == 2
    assert result.err == "fbench: --detections results: the importer of radiate takes no other system's results\n"
