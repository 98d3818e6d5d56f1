import subprocess
import sys

import pytest
from tests.cli.conftest import messages, write_log

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog, explain_losses


def raised(code):
    faults = FaultLog()
    faults.add(code, "log.mcap: here")
    with pytest.raises(LogError) as caught, explain_losses(faults):
        raise LogError("it is broken")
    return str(caught.value)


def test_only_what_was_lost_explains_an_error():
    assert raised("LOG004") == "it is broken; before that: damaged chunk skipped: log.mcap: here"
    assert raised("LOG012") == "it is broken"


@pytest.mark.parametrize("words", [["log", "info", "log.mcap"], ["log", "info", "log.mcap", "--json"]])
def test_who_stops_reading_the_output_is_not_told_no(tmp_path, words):
    """As `fbench ... | head -1` does; exit code 1 would mean that a comparison failed."""
    write_log(tmp_path / "log.mcap", messages(3))
    command = [sys.executable, "-c", "from fbench.cli import main; main()", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=tmp_path) as child:
        child.stdout.close()
        assert (child.wait(60), child.stderr.read()) == (141, b"")
