"""Commands in odd environments: what they can't do is one line and an exit code, within seconds."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

PLUGIN = """
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Output

class Quiet:
    def start(self, rig, log_info): pass
    def reset(self, reason): pass
    def step(self, frame): return Output(Boxes3D.empty(), Boxes3D.empty(), {})
"""
ODD = os.fsdecode(b"b\xffd")  # No UTF-8
PLAIN = "PYTHONUTF8=0 PYTHONCOERCECLOCALE=0 LC_ALL=C"
REPLAY = "replay {odd}/{odd}.mcap -p {odd}/{odd}.py:Quiet"
FBENCH = f"{sys.executable} -P -c 'from fbench.cli import main; main()'"


@pytest.fixture
def place(log, tmp_path):
    (tmp_path / ODD).mkdir()
    shutil.copy(log, tmp_path / ODD / f"{ODD}.mcap")
    shutil.copy(log, tmp_path / "gr\u00fcn.mcap")
    (tmp_path / ODD / f"{ODD}.py").write_text(PLUGIN)
    (tmp_path / "quiet.py").write_text(PLUGIN)
    (tmp_path / "gone").mkdir()
    return tmp_path


def run(place: Path, script: str) -> subprocess.CompletedProcess[bytes]:
    """Run a line of the shell in which `fbench` is the program."""
    lines = script.replace("fbench ", f"{FBENCH} ").replace("{odd}", ODD)
    result = subprocess.run(["/bin/bash", "-c", os.fsencode(lines)], cwd=place, capture_output=True, timeout=120)
    assert b"Traceback" not in result.stderr
    return result


CASES = {
    "full stdout": ("fbench plugins > /dev/full", 3, "fbench: output: No space left on device"),
    "full stdout, JSON": ("fbench log info car.mcap --json > /dev/full", 3, "fbench: output: No space left on device"),
    "full stderr": ("fbench log info nowhere.mcap 2> /dev/full", 3, ""),
    "closed stdout": ("fbench log check car.mcap >&-", 0, ""),
    "closed stderr": ("fbench log info nowhere.mcap 2>&-", 3, ""),
    "all closed": (f"fbench {REPLAY} -o run <&- >&- 2>&-", 0, ""),
    "20 files": ("ulimit -n 20; fbench log check car.mcap", 0, ""),
    "100 MB of addresses": ("ulimit -v 100000; fbench log info car.mcap", 2, "fbench: out of memory: ulimit -v allows"),
    "300 MB of addresses": ("ulimit -v 300000; fbench demo", 2, "fbench: out of memory: ulimit -v allows 300000 KiB"),
    "1 GB of addresses": ("ulimit -v 1000000; fbench replay car.mcap -p lidar3d", 2, "fbench: out of memory: ulimit"),
    "small files, run": ("ulimit -f 4; fbench replay car.mcap -p quiet.py:Quiet", 3, "fbench: output: File too large"),
    "small files, log": ("ulimit -f 4; fbench log convert car.mcap -o out.mcap", 3,
                         "fbench: out.mcap: can't be written (File too large)"),
    "no home": ("env -u HOME {fbench} log info car.mcap", 0, ""),
    "no cache": (f"HOME=/proc FBENCH_CACHE=/proc/none fbench {REPLAY}", 0, ""),
    "no folder": ("cd gone; rmdir ../gone; fbench log info ../car.mcap", 0, ""),
    "no folder for a run": ("cd gone; rmdir ../gone; fbench replay ../car.mcap -p ../quiet.py:Quiet", 3, "fbench: "),
    "odd names, isolated": (f"fbench {REPLAY} --isolate -o {{odd}}/run", 0, ""),
    "odd names, verified without temporary folder": (
        f"TMPDIR=/nowhere fbench {REPLAY.replace('replay', 'verify')} --quick --repeat 1", 0, ""),
    "odd names, converted": ("cd {odd}; fbench log convert {odd}.mcap -o l.mcap && fbench log info l.mcap", 0, ""),
    "odd names": (
        f"R={{odd}}/r; fbench {REPLAY} --report -o $R && fbench score $R && fbench report $R && fbench compare $R $R",
        0, ""),
    "odd name that isn't there": ("fbench log info {odd}.mcap", 3, "fbench: b d.mcap: "),
    "C locale": (f"{PLAIN} fbench {REPLAY}", 0, ""),
    "C locale, umlaut": (f"{PLAIN} fbench replay gr\u00fcn.mcap -p quiet.py:Quiet --report", 0, ""),
    "C locale, JSON": (f"{PLAIN} fbench log info gr\u00fcn.mcap --json", 0, ""),
}  # fmt: skip
QUICK = ("full stdout", "full stderr", "300 MB of addresses", "odd name that isn't there", "C locale, JSON")


@pytest.mark.parametrize("case", [pytest.param(c, marks=() if c in QUICK else pytest.mark.slow) for c in CASES])
def test_odd_environments_end_in_a_line_at_most(place, case):
    script, code, line = CASES[case]
    result = run(place, script.replace("{fbench}", FBENCH))
    err = result.stderr.decode(errors="surrogateescape")
    assert (result.returncode, err.count("\n")) == (code, 1 if line else 0), err
    assert err.startswith(line)
    assert not list(place.rglob(".*partial*"))


KEEP = "-all,+dac_override,+dac_read_search"  # What root may read stays readable, for whom no number of processes holds
NOBODY = f"setpriv --reuid 65534 --clear-groups --inh-caps={KEEP} --ambient-caps={KEEP}"
ALONE = {
    "replay": ("replay car.mcap -p quiet.py:Quiet", 3, "out of processes, threads or memory (ulimit -u"),
    "isolated": ("replay car.mcap -p quiet.py:Quiet --isolate", 2, "exec: "),
    "workers": ("robust car.mcap -p quiet.py:Quiet --condition dropout.radar", 3, "out of processes, threads"),
    "verify": ("verify car.mcap -p quiet.py:Quiet --quick", 3, "out of processes, threads or memory (ulimit -u"),
    "report": ("report run", 0, ""),  # reads and writes in one thread
}


@pytest.mark.slow
def test_no_other_process_and_no_thread(place):
    if subprocess.run([*NOBODY.split(), "true"], capture_output=True, check=False).returncode:
        pytest.skip("this user may not become another one")
    assert run(place, "fbench replay car.mcap -p quiet.py:Quiet -o run").returncode == 0
    (place / "place.py").write_text("from fbench.cli import main; main()")
    with tempfile.TemporaryDirectory() as folder:  # folders of pytest are the user's alone
        shutil.copytree(place, folder, dirs_exist_ok=True)
        Path(folder).chmod(0o777)
        for script, code, line in ALONE.values():
            out = "" if script.startswith("verify") else f"-o {'out' if line else 'page.html'}"
            command = f"{sys.executable} -P place.py {script} {out}"
            result = run(Path(folder), f"HOME={folder} {NOBODY} bash -c 'ulimit -u 1; exec {command}'")
            said = [text for text in result.stderr.decode().splitlines() if not text.startswith("<jemalloc>")]
            assert (result.returncode, len(said)) == (code, int(bool(line))), said
            assert not line or said[0].startswith(f"fbench: {line}")
            assert not (Path(folder) / "out" / "manifest.json").exists()
