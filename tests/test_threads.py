"""Threads that share work: everything is done once, and what goes wrong comes out."""

from __future__ import annotations

import pytest

from volatool.threads import Crew


@pytest.mark.parametrize("threads", [0, 1, 2, 5])
@pytest.mark.parametrize("length", [0, 1, 3, 100])
def test_all_is_shared_out_once(threads, length):
    done = []
    with Crew(threads) as crew:
        crew.run(lambda first, last: done.extend(range(first, last)), crew.shares(7, 7 + length))
        assert len(crew.shares(7, 7 + length)) == min(length, max(1, threads))
    assert sorted(done) == list(range(7, 7 + length))


@pytest.mark.parametrize("threads", [1, 2])
def test_errors_come_out(threads):
    def fail(first, last):
        raise ZeroDivisionError

    with Crew(threads) as crew, pytest.raises(ZeroDivisionError):
        crew.run(fail, crew.shares(0, 4))
