"""What a manifest says of what was replayed."""

from tests.metrics.conftest import make_manifest

from fbench.replay.runs.manifest import ConditionEntry, LogEntry


def replayed(digest: str, severity: int | None = None, seed: int | None = None) -> str:
    conditions = [] if severity is None else [ConditionEntry(name="fog", version=1, strength=str(severity), level={})]
    log = LogEntry(name="log", log_id="drive", digest=digest, metadata={})
    return make_manifest(log=log, conditions=conditions, seed=seed).data_key


def test_without_conditions_the_digest_tells_what_was_replayed():
    assert replayed("a" * 32) != replayed("b" * 32)


def test_under_conditions_sensors_that_a_pipeline_leaves_alone_do_not_count():
    assert replayed("a" * 32, 3, 1) == replayed("b" * 32, 3, 1)
    assert len({replayed("a" * 32), replayed("a" * 32, 3, 1), replayed("a" * 32, 4, 1), replayed("a" * 32, 3, 2)}) == 4
