"""Writing a file again: everything but the points is the same byte for byte, and laspy reads it."""

from __future__ import annotations

import io
import struct

import laspy
import numpy as np
import pytest

from volatool.errors import OutputError
from volatool.points.layout import RECORD_BYTES
from volatool.points.reader import open_points
from volatool.points.rewrite import Rewriter


def random_records(point_format, n=3000, n_extra=0, seed=0):
    """Return any bytes as records, one scanner channel, one class, returns 1 to 3."""
    rng = np.random.default_rng(seed)
    records = rng.integers(0, 256, (n, RECORD_BYTES[point_format] + n_extra), np.uint8)
    records[:, 14] = rng.integers(1, 4, n)
    if point_format >= 6:
        records[:, 15] &= 0xCF
    return records


def las_bytes(records, point_format, *, vlrs=(), gap=b"", behind=b"", n_evlrs=0, version=None):
    """Return a plain LAS file, written by hand."""
    minor = version or (4 if point_format >= 6 else 3 if point_format >= 4 else 2)
    size = {2: 227, 3: 235, 4: 375}[minor]
    head = bytearray(size)
    head[:4] = b"LASF"
    head[26:90] = bytes(range(64))  # system and software
    points = size + sum(map(len, vlrs)) + len(gap)
    n, end = len(records), points + records.size
    counts = np.bincount(records[:, 14] & 7, minlength=16)[1:].tolist()
    struct.pack_into("<BBxxxxxxxx", head, 24, 1, minor)
    struct.pack_into("<HIIBH", head, 94, size, points, len(vlrs), point_format, records.shape[1])
    struct.pack_into("<6I", head, 107, *([n, *counts[:5]] if point_format < 6 else [0] * 6))
    struct.pack_into("<6d", head, 131, 0.01, 0.01, 0.01, 100.0, 200.0, 0.0)
    if minor == 3 and behind:
        struct.pack_into("<Q", head, 227, end)
    if minor == 4:
        struct.pack_into("<QIQ15Q", head, 235, end if n_evlrs else 0, n_evlrs, n, *counts)
    return b"".join([bytes(head), *vlrs, gap, records.tobytes(), behind])


def vlr(user_id, record_id, data):
    return struct.pack("<H16sHH32s", 7, user_id, record_id, len(data), b"words") + data


def evlr(user_id, record_id, data):
    return struct.pack("<H16sHQ32s", 7, user_id, record_id, len(data), b"words") + data


def rewritten(data, chunk_points=1000, change=None):
    """Return the file as it is written again."""
    out = io.BytesIO()
    with open_points(io.BytesIO(data)) as source:
        writer = Rewriter(source, out)
        for _, records in source.records(chunk_points):
            writer.write(records if change is None else change(records))
        writer.finish()
    return out.getvalue()


def records_of(data):
    with open_points(io.BytesIO(data)) as source:
        parts = [records.copy() for _, records in source.records()]
        assert source.warnings[:1] == [] or source.warnings[0].code.startswith("W_")
        return np.concatenate(parts)


@pytest.mark.parametrize("n_extra", [0, 7])
@pytest.mark.parametrize("point_format", range(11))
def test_records_of_every_format_come_back(point_format, n_extra):
    """Any bytes in any field, extra bytes included; from LAS and from the LAZ made of it."""
    records = random_records(point_format, n_extra=n_extra)
    once = rewritten(las_bytes(records, point_format))
    assert np.array_equal(records_of(once), records)
    assert rewritten(once) == once
    with laspy.open(io.BytesIO(once)) as file:  # an independent reader's frame
        assert file.header.point_format.id == point_format
        assert file.header.are_points_compressed
        found = file.read().points.array
    assert np.array_equal(found.view(np.uint8).reshape(records.shape), records)


def test_bytes_do_not_depend_on_the_cut():
    records = random_records(7, 120_000)
    data = las_bytes(records, 7)
    assert rewritten(data, 999) == rewritten(data, 500_000)


def test_header_records_and_user_data_stay():
    """Only the documented fields of the header change; what stands between stays there."""
    vlrs = [vlr(b"a", 1, b"x" * 33), vlr(b"copc", 1, bytes(160)), vlr(b"LASF_Spec", 4, b"")]
    tails = [evlr(b"b", 2, b"y" * 99), evlr(b"copc", 1000, b"z" * 64), evlr(b"c", 3, b"")]
    records = random_records(6)
    data = las_bytes(records, 6, vlrs=vlrs, gap=b"user data", behind=b"".join(tails), n_evlrs=3)
    made = rewritten(data)
    changed = {at for at in range(375) if data[at] != made[at]}
    assert changed <= {*range(96, 105), *range(235, 247)}
    assert made[375 : 375 + len(vlrs[0])] == vlrs[0]
    with open_points(io.BytesIO(made)) as source:
        header = source.header
    assert [record.user_id for record in header.vlrs] == [
        "a", "LASF_Spec", "laszip encoded", "b", "c"
    ]  # fmt: skip
    assert made[header.offset_to_points - 9 : header.offset_to_points] == b"user data"
    assert made.endswith(tails[0] + tails[2])
    assert not header.is_copc


def test_internal_waveforms_move_with_their_place():
    """LAS 1.3 keeps them behind the points, where the header points to."""
    waves = evlr(b"LASF_Spec", 65535, bytes(range(200)))
    made = rewritten(las_bytes(random_records(4), 4, behind=waves))
    (place,) = struct.unpack_from("<Q", made, 227)
    assert made[place:] == waves


@pytest.mark.parametrize(("point_format", "version"), [(1, 2), (3, 4), (7, 4)])
def test_counts_are_corrected_only_when_points_are_lost(point_format, version):
    """Of each return too; a right header keeps its counts."""
    records = random_records(point_format)
    data = las_bytes(records, point_format, version=version)
    made = rewritten(data, change=lambda part: part[::2])
    kept = records_of(made)
    assert len(kept) == 1500
    returns = np.bincount(kept[:, 14], minlength=6)[1:6].tolist()
    with laspy.open(io.BytesIO(made)) as file:
        assert file.header.point_count == 1500
        assert file.header.number_of_points_by_return[:5].tolist() == returns
    assert rewritten(data)[107:131] == data[107:131]


def test_no_points_make_a_file_without_points():
    made = rewritten(las_bytes(random_records(6, 0), 6))
    with open_points(io.BytesIO(made)) as source:
        assert source.n_points == 0
        assert list(source.chunks()) == []


@pytest.mark.parametrize("point_format", [9, 10])
def test_waveforms_of_several_channels_are_refused(point_format):
    """The encoder would lose wave packets; once it doesn't, the refusal can go."""
    records = random_records(point_format)
    records[::3, 15] |= 0x10
    data = las_bytes(records, point_format)
    with pytest.raises(OutputError, match="several scanner channels"):
        rewritten(data)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Rewriter, "_refuse_channels", lambda self, records: None)
        assert not np.array_equal(records_of(rewritten(data)), records)
