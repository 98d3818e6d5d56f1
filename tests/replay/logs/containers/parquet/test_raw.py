"""Messages of other programs, kept as they are."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.replay.logs import builders as b

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.container import Channel, Entry, Schema
from fbench.replay.logs.containers.mcap.file import McapFile
from fbench.replay.logs.containers.parquet.folder import ParquetFolder
from fbench.replay.logs.containers.parquet.write import ParquetWriter


def entry(channel, log_ns, data, sequence=0, publish_ns=0):
    return Entry(log_ns, channel.topic, 0, 0, 0, 0, sequence, publish_ns, memoryview(data))


def rewritten(container, path, **how):
    """Copy all messages of a container as they are."""
    with ParquetWriter(path, b.INFO, None, **how) as writer:
        for item in container.entries(frozenset(container.channels)):
            writer.write_raw(container.channels[item.channel], item)
    return ParquetFolder(path, FaultLog())


def flat(container):
    """All entries with what is known of their channels; the numbers of channels are the container's own."""
    return [
        (e.log_ns, e.topic, e.sequence, e.publish_ns, bytes(e.data), container.channels[e.channel])
        for e in container.entries(frozenset(container.channels))
    ]


@pytest.mark.parametrize("rows_per_group", [None, 1, 5])
def test_an_mcap_log_as_it_is(tmp_path, rows_per_group):
    source = McapFile(b.write(tmp_path / "a.mcap", b.sequence(20), b.the_rig()), FaultLog())
    copy = rewritten(source, tmp_path / "a", rows_per_group=rows_per_group)
    assert flat(copy) == flat(source)
    assert copy.rigs == []
    again = rewritten(copy, tmp_path / "b")
    assert flat(again) == flat(source)


channels = st.builds(
    Channel, topic=b.names, encoding=b.texts, schema=st.none() | st.builds(Schema, b.texts, b.texts, st.binary()),
    metadata=st.dictionaries(b.texts, b.texts, max_size=2),
)  # fmt: skip
stamps = st.integers(0, 2**64 - 1)


@pytest.mark.slow
@settings(max_examples=50)
@given(st.lists(st.tuples(channels, stamps, stamps, st.integers(0, 2**32 - 1), st.binary()), max_size=5))
def test_any_channel_and_payload(tmp_path_factory, messages):
    path = Path(tmp_path_factory.mktemp("raw")) / "a"
    with ParquetWriter(path, b.INFO, None) as writer:
        for channel, log_ns, publish_ns, sequence, data in messages:
            writer.write_raw(channel, entry(channel, log_ns, data, sequence, publish_ns))
    found = flat(ParquetFolder(path, FaultLog()))
    expected = [(ns, c.topic, n, publish, data, c) for c, ns, publish, n, data in messages]
    assert found == sorted(expected, key=lambda item: item[:2])


def test_a_decoded_message_has_no_bytes(tmp_path):
    with ParquetWriter(tmp_path / "a", b.INFO, None) as writer:
        writer.write(next(iter(b.sequence(1))))
    folder = ParquetFolder(tmp_path / "a", FaultLog())
    [stored] = folder.entries(frozenset(folder.channels))
    with (
        ParquetWriter(tmp_path / "b", b.INFO, None) as writer,
        pytest.raises(LogError, match=r"can't be stored .holds no bytes"),
    ):
        writer.write_raw(folder.channels[0], stored)
