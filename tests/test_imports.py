"""The house: who may import whom, what a wheel holds, and what `--help` costs."""

import ast
import importlib
import subprocess
import sys
import zipfile
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
from tests.city_log import write_city_log

ROOT = Path(__file__).resolve().parents[1]
WINGS = ("datasets", "pipelines", "metrics", "reports")
FOLDERS = ("replay", *WINGS, "api", "cli")
MAY_IMPORT = {
    "replay": {"replay"},
    **{wing: {wing, "replay"} for wing in WINGS},
    "api": {"api", *WINGS, "replay"},
    "cli": {"cli", "api", *WINGS, "replay"},
}


def sources(folder: str) -> list[Path]:
    return sorted((ROOT / folder).rglob("*.py"))


def imported(tree: ast.AST) -> list[str]:
    names: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.append(node.module)
    return names


@pytest.mark.slow
@pytest.mark.parametrize("folder", FOLDERS)
def test_imports_form_a_star_under_one_roof(folder):
    others = set(FOLDERS) - MAY_IMPORT[folder]
    for path in sources(folder):
        bad = [
            name
            for name in imported(ast.parse(path.read_text()))
            if name.split(".")[:2] in [["fbench", o] for o in others]
        ]
        assert not bad, f"{path.relative_to(ROOT)} imports {bad}"


def name_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(("fbench", *(parts[:-1] if parts[-1] == "__init__" else parts)))


@pytest.mark.slow
def test_imports_make_no_circle():
    """Imports within functions count, too."""
    trees = {name_of(path): ast.parse(path.read_text()) for folder in FOLDERS for path in sources(folder)}
    graph: dict[str, set[str]] = {name: set() for name in trees}
    for name, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module in trees:
                found = {f"{node.module}.{alias.name}" for alias in node.names}
                graph[name] |= {one if one in trees else node.module for one in found}
    assert list(TopologicalSorter(graph).static_order())


def opens_text(node: ast.Call) -> bool:
    """Tell whether a call reads or writes text in whatever encoding the locale has."""
    name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
    given = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
    texts = [arg.value for arg in node.args if isinstance(arg, ast.Constant) and isinstance(arg.value, str)]
    modes = [text for text in (*texts, given.get("mode", "").strip("'")) if text and set(text) <= set("rwxab+")]
    opens = (
        (name in ("read_text", "write_text") and isinstance(node.func, ast.Attribute))
        or (name in ("Popen", "run", "check_output") and given.get("text") == "True")
        or (name in ("open", "fdopen") and any("b" not in mode for mode in modes))
    )
    return opens and "encoding" not in given and "utf-8" not in texts


@pytest.mark.slow
@pytest.mark.parametrize("folder", FOLDERS)
def test_text_is_utf8_whatever_the_locale_says(folder):
    for path in sources(folder):
        calls = [n for n in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(n, ast.Call)]
        found = [node for node in calls if opens_text(node)]
        assert not found, f"{path.relative_to(ROOT)}: {[f'line {n.lineno}: {ast.unparse(n)}' for n in found]}"


@pytest.mark.slow
def test_relative_imports_are_not_used():
    for folder in FOLDERS:
        for path in sources(folder):
            relative = [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.ImportFrom) and n.level]
            assert not relative, path


def loaded_by(*arguments: str) -> set[str]:
    """Modules that a command loads, itself being `fbench`."""
    code = (
        f"import sys; sys.argv = ['fbench', *{arguments!r}]\n"
        "from fbench.cli import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "print('LOADED', *sorted(sys.modules))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(result.stdout.rpartition("LOADED")[2].split())


def test_help_loads_nothing_heavy():
    loaded = loaded_by("--help")
    assert "typer" in loaded
    heavy = {
        "numpy",
        "scipy",
        "numba",
        "cv2",
        "pyarrow",
        "onnxruntime",
        "mcap",
        "google.protobuf",
        "torch",
        "pydantic",
        "plotly",
        "matplotlib",
        "jinja2",
        "sklearn",
        "pandas",
    }
    assert not heavy & loaded


@pytest.mark.slow
def test_log_info_on_mcap_loads_no_tables_kernels_or_models(tmp_path):
    write_city_log(tmp_path / "city.mcap", 0.2)
    loaded = loaded_by("log", "info", str(tmp_path / "city.mcap"))
    assert "mcap" in loaded
    assert not {"numba", "cv2", "pyarrow", "onnxruntime", "pandas", "plotly", "jinja2", "sklearn"} & loaded


@pytest.mark.slow
def test_a_replay_that_scores_and_reports_does_without_pandas(tmp_path):
    """It takes longer to import than a run of a few frames to write and score."""
    write_city_log(tmp_path / "city.mcap", 0.2)
    loaded = loaded_by("replay", str(tmp_path / "city.mcap"), "-p", "radar3d", "--report", "-o", str(tmp_path / "run"))
    assert (tmp_path / "run/report.html").is_file()
    assert not {"pandas", "torch", "sklearn"} & loaded


def test_scoring_files_loads_what_it_needs(tmp_path):
    for name in ("truth.txt", "found.txt"):
        (tmp_path / name).write_text("0 1 Car 0 0 0 10 20 60 80 1.5 1.6 4 1 2 10 0 0.9\n")
    files = ("--truth", str(tmp_path / "truth.txt"), "--detections", str(tmp_path / "found.txt"))
    loaded = loaded_by("score", *files, "--profile", "trackeval-kitti")
    assert "fbench.metrics.profiles.trackeval.profiles" in loaded
    heavy = {"pandas", "scipy.spatial", "scipy.special", "cv2", "onnxruntime", "plotly", "jinja2", "sklearn"}
    heavy |= {"ruamel.yaml", "mcap", "google.protobuf", "pyarrow.compute", "fbench.replay.runs.folder"}
    heavy |= {"fbench.cli.replay", "fbench.cli.bench", "fbench.cli.log_import"}
    assert not (heavy | {"fbench.api.suites.bench", "fbench.replay.conditions.disturb"}) & loaded


def test_the_api_has_what_it_names():
    api = importlib.import_module("fbench.api")
    assert [getattr(api, name).__name__ for name in api.__all__] == api.__all__
    assert set(api.__all__) <= set(dir(api))
    with pytest.raises(AttributeError, match="no attribute 'replya'"):
        api.replya  # noqa: B018


@pytest.mark.slow
def test_wheel_holds_the_tree(tmp_path):
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "-w",
        str(tmp_path),
        str(copy(tmp_path)),
    ]
    subprocess.run(command, check=True)
    (wheel,) = tmp_path.glob("fbench-*.whl")
    held = {name for name in zipfile.ZipFile(wheel).namelist() if name.startswith("fbench/")}
    tree = {
        f"fbench/{p.relative_to(ROOT)}"
        for folder in FOLDERS
        for p in (ROOT / folder).rglob("*")
        if p.is_file() and "__pycache__" not in p.parts
    }
    assert held == tree


def copy(tmp_path: Path) -> Path:
    """Build from a copy, so that the tree stays free of build folders."""
    import shutil

    target = tmp_path / "source"
    target.mkdir()
    for folder in FOLDERS:
        shutil.copytree(ROOT / folder, target / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, target / name)
    return target
