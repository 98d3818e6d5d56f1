"""Every command in README and docs is run: blocks marked `console`, lines that begin with `$ `, one folder a file.

A block's commands must succeed, unless the line ends with a comment `# exit N`. Python blocks whose first line is a
comment with a file name are written there first. Commands that need recordings or weights skip where there are none.
Those of fbench and python run in this process, as to start 150 others takes minutes.
"""

import ast
import os
import re
import runpy
import shlex
import subprocess
import sys
from glob import glob
from pathlib import Path

import pytest
from tests.cli.conftest import circumstances, in_this_process
from tests.kept_cities import shared_cities
from tests.program import fbench

__all__ = ["circumstances", "in_this_process"]

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md")])
ELSEWHERE = ("git clone", "cd fbench", "make ", "pip install", "source ")
"""What other tests, or CI itself, run."""

RECORDINGS = {name: f"data/{name}" for name in ("astyx", "kitti_object", "kitti_tracking", "radiate_tiny_foggy")}
WEIGHTS = {
    "deimv2.onnx": "weights/deimv2_femto/deimv2_hgnetv2_femto_coco.onnx",
    "yolox_nano.onnx": "weights/yolox_nano/yolox_nano.onnx",
}
BESIDE = RECORDINGS | WEIGHTS
"""Where the pages find recordings and weights, and where those are in ../shared."""
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(page: Path, language: str) -> list[str]:
    return [body for kind, body in BLOCK.findall(page.read_text()) if kind == language]


def commands(page: Path) -> list[tuple[str, int]]:
    lines = [line[2:] for body in blocks(page, "console") for line in body.splitlines() if line.startswith("$ ")]
    found = [(line.partition(" # exit ")[0], int(line.partition(" # exit ")[2] or 0)) for line in lines]
    return [(command, code) for command, code in found if not command.startswith(ELSEWHERE)]


def with_commands() -> list[Path]:
    return [page for page in PAGES if commands(page)]


@pytest.fixture
def workplace(tmp_path):
    """An empty folder with what the pages assume: the small log, and recordings and weights where there are any."""
    from tests.city_log import write_city_log

    (tmp_path / "runs" / "demo").mkdir(parents=True)
    write_city_log(tmp_path / "runs" / "demo" / "city.mcap", seconds=1.0)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    shared = ROOT.parent / "shared"
    for name, target in BESIDE.items():
        if name == "astyx":
            link_first_frames(shared / target, tmp_path / name)
        elif (shared / target).exists():
            (tmp_path / name).symlink_to(shared / target)
    return tmp_path


def link_first_frames(recording: Path, folder: Path, num: int = 16) -> None:
    """Of 47: `test_astyx_end_to_end` replays all."""
    for kind in sorted(path for path in recording.glob("*") if path.is_dir()):
        (folder / kind.name).mkdir(parents=True)
        for file in sorted(kind.iterdir())[:num]:
            (folder / kind.name / file.name).symlink_to(file)


def exit_code(command: str) -> int:
    """Run a command as a shell does; `fbench WORDS`, `python FILE WORDS` and `python -c CODE` need none."""
    if not command.startswith(("fbench ", "python ")):
        return subprocess.run(command, shell=True).returncode
    program, *words = shlex.split(command)
    if program == "python":
        return python(*words)
    return fbench(*(name for word in words for name in sorted(glob(word)) or [word]))


def python(*words: str) -> int:
    """Run a program in this process as its main module; what it imports from its folder is forgotten."""
    before = set(sys.modules)
    with pytest.MonkeyPatch.context() as patch, shared_cities():
        patch.syspath_prepend("" if words[0] == "-c" else str(Path(words[0]).resolve().parent))
        patch.setattr(sys, "argv", ["-c"] if words[0] == "-c" else list(words))
        try:
            if words[0] == "-c":
                exec(words[1], {"__name__": "__main__"})  # noqa: S102  # a command of the page
            else:
                runpy.run_path(words[0], run_name="__main__")
        except SystemExit as stop:
            return stop.code if isinstance(stop.code, int) else int(stop.code is not None)
        finally:
            for name in set(sys.modules) - before:
                if not name.startswith("fbench") and Path.cwd() in Path(_file(name)).parents:
                    del sys.modules[name]
    return 0


def _file(name: str) -> str:
    return getattr(sys.modules[name], "__file__", None) or "/"


@pytest.mark.slow
@pytest.mark.parametrize("page", with_commands(), ids=lambda page: page.name)
def test_commands_of_a_page_work(page, workplace, monkeypatch, capfd, circumstances, in_this_process):
    circumstances("repeat")  # `test_verify` tries all, in processes of their own
    in_this_process()
    for body in (*blocks(page, "python"), *blocks(page, "toml")):
        if name := re.match(r"# (\S+\.(?:py|toml))\n", body):
            (workplace / name[1]).write_text(body)
    monkeypatch.chdir(workplace)
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    for command, code in commands(page):
        needs = [name for name in BESIDE if re.search(rf"(?<![\w./-]){re.escape(name)}(?![\w.-])", command)]
        if any(not (workplace / need).exists() for need in needs):
            pytest.skip(f"`{command}` needs {needs}, which aren't beside this repository")
        found = exit_code(command)
        said = capfd.readouterr()
        assert found == code, f"{command}\n{said.out}{said.err}"


def test_the_installed_program_is_found():
    program = Path(sys.executable).parent / "fbench"
    assert subprocess.run([program, "--version"], capture_output=True, text=True).stdout.startswith("0.")


def test_links_between_pages_lead_somewhere():
    for page in [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]:
        for link in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
            if not link.startswith("http"):
                assert (page.parent / link).exists(), f"{page.name} links to {link}"


def test_plug_ins_of_outsiders_need_contracts_and_data_only():
    allowed = ("fbench.replay.contracts.", "fbench.replay.data.")
    found = [
        name
        for block in blocks(ROOT / "docs/plugins.md", "python")
        for node in ast.walk(ast.parse(block))
        for name in ([node.module] if isinstance(node, ast.ImportFrom) else [])
        if name.startswith("fbench")
    ]
    assert len(found) > 10
    assert [name for name in found if not name.startswith(allowed)] == []


def test_fault_table_of_the_docs_is_the_one_in_the_code():
    from fbench.replay.contracts.faults import FAULTS

    rows = [f"| {code} | {kind.behaviour} | {kind.text} |" for code, kind in FAULTS.items()]
    assert "\n".join(rows) in (ROOT / "docs" / "faults.md").read_text()


def test_dependencies_are_pinned_and_explained():
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = [
        re.split(r"[><=\[]", d)[0].lower()
        for d in [*project["dependencies"], *project["optional-dependencies"]["test"]]
    ]
    pinned = {line.partition("==")[0].lower() for line in (ROOT / "constraints.txt").read_text().splitlines()}
    explained = (ROOT / "docs" / "dependencies.md").read_text()
    for name in wanted:
        assert name in pinned, name
        assert name in explained, name
