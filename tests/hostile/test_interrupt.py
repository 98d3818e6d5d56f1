"""Killed commands, full disks, folders in which nothing may be written; `tests.hostile.interrupt` does more of it."""

import json
import subprocess
import sys

import pytest
from tests.hostile.run import ROOT

pytestmark = pytest.mark.slow
HOW = {"kills": 6, "full": 4, "locked": 4}


@pytest.mark.parametrize("how", HOW)
def test_nothing_is_lost_and_nothing_half_passes_for_whole(how):
    command = [sys.executable, "-m", "tests.hostile.interrupt", f"--{how}", str(HOW[how]), "--seed", "1", "--dry"]
    command += ["--commands", "replay", "convert", "import", "report"]  # the others take minutes
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    counts = json.loads(done.stdout.splitlines()[-1])[how]
    assert counts["wrong"] == 0
    if any(name.startswith("skipped") for name in counts):
        pytest.skip("no file system may be mounted here")
