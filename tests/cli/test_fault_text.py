import pytest

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
