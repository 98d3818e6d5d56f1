import tomllib
from pathlib import Path

from fbench.replay.runs.manifest import describe_host, package_versions

NO_MATTER = {
    "foxglove-schemas-protobuf", "isal", "jinja2", "lz4", "pandas", "platformdirs", "pydantic", "rich", "ruamel.yaml",
    "typer", "xxhash", "zstandard",
}  # fmt: skip
"""They show things, check them, or give back exactly what went in."""


def test_every_package_that_decides_results_is_listed():
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed = {line.partition(">=")[0].strip() for line in project["dependencies"]}
    listed = package_versions()
    assert needed == (set(listed) - {"fbench", "python", "llvmlite"}) | NO_MATTER
    assert "absent" not in listed.values()


def test_the_host_is_told():
    assert set(describe_host()) == {"cpu", "cores", "platform", "python"}
