"""Logs that were made here, and are still as they were."""

from fbench.api.suites.cells import is_sealed_log, seal_log, was_sealed


def test_a_log_is_sealed_until_it_changes(tmp_path):
    log = tmp_path / "a.mcap"
    log.write_bytes(b"content")
    assert not is_sealed_log(log, "id-1")
    assert not was_sealed(log)
    seal_log(log, "id-1")
    assert is_sealed_log(log, "id-1")
    assert was_sealed(log)
    assert not is_sealed_log(log, "id-2")
    log.write_bytes(b"contenT")
    assert not is_sealed_log(log, "id-1")
    log.unlink()
    assert not is_sealed_log(log, "id-1")


def test_a_damaged_seal_is_none(tmp_path):
    log = tmp_path / "a.mcap"
    log.write_bytes(b"content")
    for text in ("", "[]", "{}", '{"log_id": "id-1", "digest": 5}'):
        (tmp_path / ".a.mcap.seal").write_text(text)
        assert not is_sealed_log(log, "id-1")
