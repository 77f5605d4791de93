"""Reading ahead gives the same items and errors, and its thread never outlives the block."""

from __future__ import annotations

import threading
import time

import pytest

from volatool.ahead import ahead


def readers():
    return [thread for thread in threading.enumerate() if thread.name == "volatool-reader"]


def counting(n, seen, fails_at=None):
    try:
        for i in range(n):
            if i == fails_at:
                raise ValueError(f"bad item {i}")
            seen.append(i)
            yield i
    finally:
        seen.append("closed")


def test_the_items_come_in_order_from_another_thread():
    seen, threads = [], set()

    def items():
        for item in counting(100, seen):
            threads.add(threading.current_thread())
            yield item

    with ahead(items()) as found:
        assert list(found) == list(range(100))
    assert threads != {threading.current_thread()}
    assert not readers()


def test_not_more_than_asked_for_wait():
    seen = []
    with ahead(counting(100, seen), n_ahead=2) as found:
        for i, item in zip(range(5), found, strict=False):
            time.sleep(0.02)
            assert item == i
            assert len(seen) <= i + 4  # the one in use, two that wait, one that is made
    assert seen[-1] == "closed"
    assert len(seen) < 12


@pytest.mark.parametrize("fails_at", [0, 3, 50])
def test_an_error_comes_after_the_items_before_it(fails_at):
    seen, found = [], []
    with (
        pytest.raises(ValueError, match=f"bad item {fails_at}"),
        ahead(counting(100, seen, fails_at)) as items,
    ):
        found.extend(items)
    assert found == list(range(fails_at))
    assert seen[-1] == "closed"
    assert not readers()


@pytest.mark.parametrize("kind", [RuntimeError, KeyboardInterrupt, GeneratorExit])
def test_a_user_that_raises_ends_the_thread(kind):
    """The generator is closed at the item it is at, although nobody takes the others."""
    seen = []

    def use():
        with ahead(counting(10**9, seen)) as items:
            next(items)
            raise kind

    with pytest.raises(kind):
        use()
    assert seen[-1] == "closed"
    assert not readers()


def test_a_user_that_takes_nothing_ends_the_thread():
    seen = []
    with ahead(counting(10**9, seen)):
        pass
    assert seen[-1] == "closed"
    assert not readers()


def test_an_error_that_nobody_asks_for_is_dropped():
    with ahead(counting(5, [], fails_at=1)) as items:
        assert next(items) == 0


def test_exceptions_that_are_no_errors_come_through():
    """A panic of the decoder is a BaseException; so is Ctrl-C in the thread."""

    class PanicException(BaseException):
        pass

    def items():
        yield 1
        raise PanicException("index out of range")

    with pytest.raises(PanicException, match="index out"), ahead(items()) as found:
        list(found)
    assert not readers()
