"""Answers of child processes, alone on their stdout whatever else is written, in UTF-8 whatever the locale says."""

import os
import subprocess
import sys

import pytest

ASCII = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
CHILD = """
import os, subprocess, sys
from fbench.api.suites.cells import own_stdout

with own_stdout() as out:
    print("printed")
    os.write(1, b"by a library\\n")
    subprocess.run(["echo", "by a program"], check=True)
    print("first \\xc4", file=out, flush=True)
    sys.__stdout__.write("kept back\\n")
    print("second", file=out)
print("after")
"""
WRITER = """
from pathlib import Path
from fbench.replay.data.files import replace_text

replace_text(Path("text.txt"), "\\u2212 \\xc4")
"""


@pytest.mark.parametrize("environment", [dict(os.environ), ASCII], ids=["usual", "ASCII"])
def test_nothing_else_gets_between_answers(environment):
    done = subprocess.run([sys.executable, "-c", CHILD], capture_output=True, env=environment)
    assert done.returncode == 0
    assert done.stdout.decode("utf-8") == "first Ä\nsecond\n"
    said = done.stderr.decode().splitlines()
    assert sorted(said) == ["after", "by a library", "by a program", "kept back", "printed"]


def test_texts_are_utf8_in_any_locale(tmp_path):
    subprocess.run([sys.executable, "-c", WRITER], cwd=tmp_path, env=ASCII, check=True)
    assert (tmp_path / "text.txt").read_bytes() == "\u2212 Ä".encode()
