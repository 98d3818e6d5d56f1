import threading

import pytest

from fbench.datasets.importing.run import NUM_AHEAD, ahead


def test_the_same_items_in_the_same_order():
    assert list(ahead(iter(range(100)))) == list(range(100))
    assert list(ahead(iter([]))) == []


def test_no_more_than_so_many_are_taken_before_they_are_wanted():
    taken = []

    def numbers():
        for i in range(100):
            taken.append(i)
            yield i

    items = ahead(numbers())
    assert next(items) == 0
    del items
    assert len(taken) <= NUM_AHEAD + 1


def test_an_error_comes_where_its_item_would_have():
    def broken():
        yield 1
        yield 2
        raise ValueError("here")

    items = ahead(broken())
    assert [next(items), next(items)] == [1, 2]
    with pytest.raises(ValueError, match="here"):
        next(items)


def test_one_thread_asks_for_all_and_ends_with_the_iteration():
    names = list(ahead(threading.current_thread().name for _ in range(10)))
    assert len(set(names)) == 1
    assert names[0] != threading.current_thread().name
    assert names[0] not in [thread.name for thread in threading.enumerate()]
