"""The examples for CI, as a user would take them: from two branches of a toy pipeline to a red and a green job."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML
from tests.cli.conftest import MS, car_points, rig, write_log

from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import PointCloud, Truth

EXAMPLES = Path(__file__).resolve().parents[2] / "examples/ci"
PIPELINE = """
import numpy as np
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Output

class MyPipeline:
    def start(self, rig, log_info): pass
    def reset(self, reason): pass
    def step(self, frame):
        points = frame.messages["lidar"].xyz
        car = points[points[:, 2] > 0.3]
        center = np.array([[car[:, 0].min() + 2.0, 0.0, 0.75]]) if len(car) else np.zeros((0, 3))
        num = len(center)
        boxes = Boxes3D(center, np.tile([4.0, 1.8, 1.5], (num, 1)), np.zeros(num),
                        label=np.array(["car"] * num, str), track_id=np.zeros(num, int))
        return Output(boxes, boxes, {})
"""


def write_drive(path: Path) -> None:
    """10 s of a car that drives away."""
    items: list[PointCloud | Truth] = []
    for i in range(100):
        stamp, x = 1_000_000_000 + 100 * MS * i, 14.0 + i / 4
        items.append(PointCloud("lidar", stamp, stamp + MS, car_points(x)))
        sizes, ids = np.array([[4.0, 1.8, 1.5]]), np.array([3])
        box = Boxes3D(np.array([[x, 0, 0.75]]), sizes, np.zeros(1), label=np.array(["car"]), track_id=ids)
        items.append(Truth(stamp, stamp, box))
    path.parent.mkdir(parents=True)
    write_log(path, items, rig(camera=False))


def call(folder: Path, command: str, **env: str) -> subprocess.CompletedProcess[str]:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    who = {f"GIT_{role}_{what}": "Ada" for role in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}
    full = {**os.environ, **who, "PATH": path, **env}
    words = ["bash", "-ec", command]
    return subprocess.run(words, cwd=folder, env=full, capture_output=True, text=True, check=False)


GITHUB = {"GITHUB_SERVER_URL": "https://git.example", "GITHUB_REPOSITORY": "ada/cars", "GITHUB_RUN_ID": "17"}


def run_job(folder: Path) -> tuple[int, str]:
    """Run the steps of GitHub's job that are fbench's; returns the exit code and the step summary."""
    job = YAML(typ="safe").load((EXAMPLES / "github.yml").read_text(encoding="utf-8"))["jobs"]["gate"]
    summary, code = folder / "summary.md", 0
    for step in job["steps"]:
        if code == 0 and step.get("run", "").startswith("fbench"):
            code = call(folder, step["run"], GITHUB_STEP_SUMMARY=str(summary), **GITHUB).returncode
    return code, summary.read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("git") is None, reason="needs git")
def test_a_branch_that_is_worse_turns_the_job_red(tmp_path: Path) -> None:
    home = tmp_path / "home"
    write_drive(home / "logs/drive.mcap")
    (home / "my_pipeline.py").write_text(PIPELINE, encoding="utf-8")
    gates = (EXAMPLES / "gate.toml").read_text(encoding="utf-8").split("[[gate]]")
    # As docs/ci.md says: without the gate on a range in which nothing is.
    (home / "gate.toml").write_text("[[gate]]".join(g for g in gates if "recall" not in g), encoding="utf-8")
    (home / ".gitignore").write_text("runs/\n", encoding="utf-8")
    words = "git init -qb main; git config user.name Ada; git add .; git commit -qm first; "
    words += "fbench replay logs/drive.mcap -p my_pipeline.py:MyPipeline -o runs/trusted; "
    words += "fbench baseline accept runs/trusted --reason 'first version' -o baseline.json; "
    words += "git add .; git commit -qm baseline; git checkout -qb worse; "
    words += "sed -i 's/if len(car)/if frame.index % 3/' my_pipeline.py; git commit -qam 'Skip every third frame'"
    made = call(home, words)
    assert made.returncode == 0, made.stderr
    assert json.loads((home / "baseline.json").read_text(encoding="utf-8"))["accepted"]["by"] == "Ada"
    for branch in ("main", "worse"):
        assert call(tmp_path, f"git clone -q --branch {branch} home {branch}").returncode == 0
    code, summary = run_job(tmp_path / "worse")
    assert code == 1
    assert "[Report and files of this run](https://git.example/ada/cars/actions/runs/17)" in summary
    assert summary.startswith("### fbench: REGRESSED: my\\_pipeline-MyPipeline: f1, vehicle")
    assert (tmp_path / "worse/comment.md").read_text(encoding="utf-8") == summary
    code, summary = run_job(tmp_path / "main")
    assert (code, summary) == (0, "identical: all outputs have equal digests\n")
    assert not (tmp_path / "main/comment.md").exists()
