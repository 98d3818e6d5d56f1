"""Thrift's compact protocol from a stranger: what it claims is bounded by what is there."""

import pytest

from fbench.replay.logs.containers.parquet.footer import DamageError, read_struct

LIST, STRUCT, DOUBLE, END = 9, 12, 7, b"\0"
FIELD = bytes([0x10 | LIST])  # The next field of a struct, a list


def test_a_list_of_numbers_that_are_not_there_is_refused_at_once():
    claimed = b"\xff\xff\xff\xff\xff\xff\xff\x7f"  # A varint of 56 bits
    with pytest.raises(DamageError, match="cut off"):
        read_struct(memoryview(FIELD + bytes([0xF0 | DOUBLE]) + claimed + bytes(16) + END))


@pytest.mark.parametrize("num", [10, 100_000])
def test_lists_in_lists_are_as_deep_as_structs(num):
    data = memoryview(FIELD + bytes([0x10 | LIST]) * num + bytes([0x00 | STRUCT]) + END)
    if num == 10:
        assert read_struct(data)[1] == len(data)
        return
    with pytest.raises(DamageError, match="nested too deeply"):
        read_struct(data)
