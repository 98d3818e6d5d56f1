"""A log is known by its spec and `VERSION`, so whoever changes what a spec gives must raise that."""

import json

import pytest
from tests.datasets.city.pins import PINNED, SPECS, pin, surroundings

from fbench.datasets.city.spec import VERSION

ANEW = "write the record anew: python -m tests.datasets.city.pins"
RAISE = f"the same spec gives another log: raise VERSION in datasets/city/spec.py, then {ANEW}"


@pytest.mark.parametrize("name", ["highway", pytest.param("urban", marks=pytest.mark.slow)])  # which has dense traffic
def test_the_same_spec_gives_the_same_log_until_its_version_rises(name):
    record = json.loads(PINNED.read_text(encoding="utf-8"))
    assert record["version"] == VERSION, f"VERSION was raised: {ANEW}"
    now, then = pin(SPECS[name]), record["logs"][name]
    if surroundings() == record["made_with"]:
        assert now["digests"] == then["digests"], RAISE
    else:  # rays, JPEG and trigonometry differ in their last digits between processors, and between packages
        assert now["digests"]["metadata"] == then["digests"]["metadata"], RAISE
    assert now["stamps"] == then["stamps"], RAISE
    assert_like(now["about"], then["about"])


def assert_like(now, then):
    assert now.keys() == then.keys(), RAISE
    for stream, messages in then.items():
        assert len(now[stream]) == len(messages), RAISE
        for found, expected in zip(now[stream], messages, strict=True):
            assert found == pytest.approx(expected, rel=0.01, abs=0.01), f"{stream}: {RAISE}"


def test_the_record_covers_every_kind_of_stream():
    logs = json.loads(PINNED.read_text(encoding="utf-8"))["logs"]
    assert logs.keys() == SPECS.keys()
    for log in logs.values():
        assert log["digests"].keys() == {"camera", "lidar", "radar", "pose", "truth", "metadata"}


def test_a_change_is_told():
    then = json.loads(PINNED.read_text(encoding="utf-8"))["logs"]["urban"]["about"]
    other = json.loads(json.dumps(then))
    other["lidar"][0]["xyz mean"] *= 1.05
    with pytest.raises(AssertionError, match="raise VERSION"):
        assert_like(other, then)
