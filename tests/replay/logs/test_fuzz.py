"""Bit flips and cuts of MCAP files of every kind: never silently wrong or short, never another error."""

import os
import shutil
from collections import Counter
from contextlib import suppress

import numpy as np
import pytest
from mcap.opcode import Opcode
from mcap.writer import CompressionType
from tests.replay.logs import builders as b
from tests.replay.logs.other_forms import NO_SUMMARY, layout, rewrite

from fbench.replay.contracts.errors import FbenchError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.open import open_container

KINDS = {
    "unchunked": {"use_chunking": False},
    "none": {"compression": CompressionType.NONE},
    "lz4": {"compression": CompressionType.LZ4},
    "zstd": {"compression": CompressionType.ZSTD},
    "no summary": {"compression": CompressionType.ZSTD, **NO_SUMMARY},
}


@pytest.fixture(scope="module", params=[*KINDS, "ours"])
def log(request, tmp_path_factory):
    """A log, and all that is in it."""
    folder = tmp_path_factory.mktemp("log")
    path = b.write(folder / "ours.mcap", b.sequence(6, points=10), b.the_rig(), chunk_size=3000)
    if request.param in KINDS:
        path = rewrite(path, folder / "log.mcap", chunk_size=3000, **KINDS[request.param])
    return path, whole(path)


def whole(path):
    """Messages, truths, info and rig, `None` where it can't be told; and the faults."""
    reader, faults = b.read(path)
    messages = [repr(b.canonical(m)) for m in reader.messages()]
    truths = [repr(b.canonical(t)) for t in reader.truths()]
    about, rig = b.canonical(reader.info), None
    with suppress(FbenchError):
        rig = b.canonical(reader.rig)
    return (messages, truths, about[2:], rig), faults


def check(path, expected, where):
    """Whatever was done to the log: it is refused, or all is as it was, or what is lost was counted."""
    with suppress(FbenchError):
        found, faults = whole(path)
        assert found == expected[0] or faults.num_lost, where
        if not faults.counts["LOG006"]:  # as of a file that is cut off where the checksum would be
            assert not Counter(found[0] + found[1]) - Counter(expected[0][0] + expected[0][1]), where


def flip(data, bits, path, expected):
    for bit in bits:
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        check(path, expected, f"bit {bit}")


@pytest.mark.slow
def test_bits_anywhere(log, tmp_path):
    data = log[0].read_bytes()
    rng = np.random.Generator(np.random.Philox(11))
    flip(data, rng.integers(0, 8 * len(data), 60).tolist(), tmp_path / log[0].name, log[1])


def test_bits_of_what_has_no_checksum_of_its_own(log, tmp_path):
    data = log[0].read_bytes()
    heads = [at * 8 + i for opcode, at, _ in layout(data) if opcode == Opcode.CHUNK for i in range(8)]
    names = [(at + i) * 8 for opcode, at, _ in layout(data) if opcode == Opcode.METADATA for i in range(20)]
    rng = np.random.Generator(np.random.Philox(12))
    flip(data, [*rng.permutation(heads)[:24].tolist(), *names], tmp_path / log[0].name, log[1])


@pytest.mark.slow
def test_many_bits(log, tmp_path):
    data = log[0].read_bytes()
    rng = np.random.Generator(np.random.Philox(13))
    flip(data, rng.integers(0, 8 * len(data), 600).tolist(), tmp_path / log[0].name, log[1])


def ends_of(data):
    """Ends of what can be delivered: of each chunk, or of each message outside chunks."""
    return [at + n for opcode, at, n in layout(data) if opcode in (Opcode.CHUNK, Opcode.MESSAGE)]


def test_a_cut_delivers_what_is_whole_before_it(log, tmp_path):
    """Cuts inside the data; the log that ends at a record's end tells what there is to deliver."""
    data = log[0].read_bytes()
    borders = [8, *(at + n for _, at, n in layout(data))]
    cuts = np.linspace(9, ends_of(data)[-1] + 9, 25).astype(int).tolist()
    for cut in cuts:
        path, last = tmp_path / log[0].name, max(end for end in borders if end <= cut)
        path.write_bytes(data[:cut])
        found, faults = whole(path)
        path.write_bytes(data[:last])
        assert found == whole(path)[0], cut
        ends = sum(end <= cut for end in ends_of(data))
        assert sum(open_container(path, FaultLog()).counts.values()) >= ends, cut
        assert faults.places["LOG002"][0].startswith(f"{path.name}: truncated at byte {last}, last good stamp "), cut


def test_a_file_that_shrinks_while_it_is_read(log, tmp_path):
    path = shutil.copy(log[0], tmp_path / "log.mcap")
    reader, faults = b.read(path)
    os.truncate(path, path.stat().st_size // 4)
    assert len(list(reader.messages())) < len(log[1][0][0])
    assert faults.num_lost
