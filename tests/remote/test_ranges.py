"""What a file read by ranges asks for: blocks once, ahead when it pays, only what is planned."""

from __future__ import annotations

import io

import numpy as np
import pytest

from volatool.errors import InputError
from volatool.remote import ranges, store
from volatool.remote.path import RemotePath
from volatool.remote.ranges import BLOCK, PART, RangeFile

PATH = RemotePath("memory://a/b.bin")


@pytest.fixture
def data():
    return np.random.default_rng(0).bytes(48 * PART // 4 + 123)


@pytest.fixture
def asked(data):
    """A file over the bytes, and the ranges that were asked for."""
    log = []

    def fetch(start, stop):
        log.append((start, stop))
        return data[start:stop]

    with RangeFile(PATH, len(data), fetch) as file:
        file.log = log
        yield file


def test_reading_on_fetches_every_byte_once_in_longer_and_longer_parts(asked, data):
    pieces = list(iter(lambda: asked.read(100_000), b""))
    assert b"".join(pieces) == data
    assert sum(stop - start for start, stop in asked.log) == len(data) == asked.n_bytes
    longest = max(stop - start for start, stop in asked.log)
    assert PART // 2 <= longest <= PART
    assert asked.n_requests < 40


def test_any_order_of_reads_gives_the_bytes_of_the_file(asked, data):
    random = np.random.default_rng(1)
    for start in random.integers(0, len(data), 300):
        n = int(random.choice([1, 100, BLOCK, 3 * BLOCK + 1, 200_000]))
        asked.seek(int(start))
        assert asked.read(n) == data[start : start + n]
        if random.random() < 0.3:
            assert asked.read(n) == data[start + n : start + 2 * n]
    kept = sum(run.end - run.first for run in asked._runs.values()) * BLOCK
    assert kept <= ranges.KEPT_BYTES
    assert len(asked._of_block) * BLOCK == kept


def test_a_header_and_a_tail_are_a_block_each(asked, data):
    for n in (375, 54, 20, 54, 500):
        asked.read(n)
    asked.seek(-8, io.SEEK_END)
    assert asked.read() == data[-8:]
    assert asked.n_requests == 2
    assert asked.n_bytes <= 2 * BLOCK


def test_only_what_is_planned_is_fetched(asked, data):
    plan = [(BLOCK * at, BLOCK * (at + 3)) for at in range(7, 600, 50)]
    asked.expect(plan)
    for start, stop in plan:
        asked.seek(start)
        assert asked.read(stop - start) == data[start:stop]
    assert asked.n_bytes == sum(stop - start for start, stop in plan)
    assert asked.n_requests == len(plan)


def test_neighbouring_chunks_of_a_plan_share_requests(asked, data):
    plan = [(start, start + 30_000) for start in range(1000, 8 * PART, 30_000)]
    asked.expect(plan)
    for start, stop in plan:
        asked.seek(start)
        assert asked.read(stop - start) == data[start:stop]
    assert asked.n_requests <= 8 * PART // (PART // 2) + 2


def test_positions_and_ends(asked, data):
    assert asked.seek(0, io.SEEK_END) == len(data)
    assert asked.read(5) == b""
    assert asked.seek(-3, io.SEEK_CUR) == len(data) - 3
    assert asked.read(50) == data[-3:]
    asked.seek(10)
    buffer = bytearray(20)
    assert asked.readinto(buffer) == 20
    assert bytes(buffer) == data[10:30]
    assert asked.tell() == 30
    assert asked.seek(-5) == 0
    assert asked.seekable()
    assert asked.readable()
    asked.close()
    with pytest.raises(ValueError, match="closed"):
        asked.read(1)


@pytest.mark.parametrize("n_short", [1, 10])
def test_an_answer_that_is_too_short_is_asked_for_again(monkeypatch, n_short):
    monkeypatch.setattr(store, "DELAYS", (0.0,) * 3)
    answers = [b"abc"] * n_short

    def fetch(start, stop):
        return answers.pop() if answers else b"abcdef"

    with RangeFile(PATH, 6, fetch) as file:
        if n_short == 1:
            assert file.read() == b"abcdef"
            return
        with pytest.raises(InputError, match="3 bytes came instead of 6") as caught:
            file.read()
    assert caught.value.code == "E_NETWORK"
