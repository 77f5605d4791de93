"""Scan files and pipes: every kind reads, and damage is named with its place."""

from __future__ import annotations

import io
import os
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from making_scans import lzf_pack, npy_bytes, pcd_bytes, scan

from volatool.errors import (
    FormatError,
    InputError,
    InputNotFoundError,
    ResourceError,
    TruncatedError,
    VolatoolError,
)
from volatool.kernels import lzf
from volatool.points.frames import frames_of_files, frames_of_npy, read_frame
from volatool.points.pcd import parse_pcd
from volatool.points.poses import read_poses

KINDS = ["ascii", "binary", "binary_compressed"]
SAMPLES = Path(__file__).resolve().parents[2] / "data_samples"


@pytest.fixture
def points():
    xyz = scan(n=300).astype(np.float32).astype(np.float64)
    xyz[17] = np.nan  # a direction without a return
    return xyz


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dtype", ["f4", "f8"])
def test_pcd_of_each_kind(points, kind, dtype, tmp_path):
    path = tmp_path / "scan.pcd"
    path.write_bytes(pcd_bytes(points, kind, dtype))
    np.testing.assert_array_equal(read_frame(path), points)


@pytest.mark.parametrize("kind", KINDS)
def test_pcd_of_integers_and_without_points(kind):
    xyz = np.arange(12.0).reshape(4, 3)
    np.testing.assert_array_equal(parse_pcd(pcd_bytes(xyz, kind, "i4")), xyz)
    assert parse_pcd(pcd_bytes(xyz[:0], kind)).shape == (0, 3)


def test_packed_points_really_are(points):
    """The test's packer makes references, so that the reader's are tested."""
    assert len(pcd_bytes(points, "binary_compressed")) < len(pcd_bytes(points, "binary"))


@given(st.binary(max_size=600), st.integers(1, 40))
@settings(max_examples=60, deadline=None)
def test_lzf_reads_what_was_packed(data, repeats):
    data = (data * repeats)[:4000]
    out = np.empty(len(data), np.uint8)
    assert lzf.decompress(np.frombuffer(lzf_pack(data), np.uint8).copy(), out) == len(data)
    assert out.tobytes() == data


@given(st.binary(max_size=200), st.integers(0, 400))
@settings(max_examples=100, deadline=None)
def test_lzf_of_garbage_stays_in_its_arrays(data, size):
    out = np.zeros(size + 64, np.uint8)
    n = lzf.decompress(np.frombuffer(data, np.uint8).copy(), out[:size])
    assert -1 - len(data) <= n <= size
    assert not out[size:].any()


@pytest.mark.parametrize("kind", KINDS)
def test_every_truncation_of_a_pcd_is_named(points, kind):
    data = pcd_bytes(points[:20], kind)
    for end in [*range(1, len(data) - 12, 7)]:
        with pytest.raises(FormatError) as caught:
            parse_pcd(data[:end])
        if end >= data.index(b"DATA"):
            assert caught.value.code == "E_TRUNCATED"


@given(st.integers(0, 10**6), st.integers(0, 255))
@settings(max_examples=150, deadline=None)
def test_a_changed_byte_is_an_error_or_other_points(place, value):
    for kind in KINDS:
        data = bytearray(pcd_bytes(scan(n=12), kind))
        data[place % len(data)] = value
        code = "none"
        try:
            assert parse_pcd(bytes(data)).shape[1] == 3
        except VolatoolError as error:
            code = error.code
        assert code in ("none", "E_CORRUPT", "E_TRUNCATED", "E_SIZE")


@pytest.mark.parametrize(
    ("change", "error", "match"),
    [
        ((b"POINTS 20", b"POINTS 99999999999"), ResourceError, "claims"),
        ((b"POINTS 20", b"POINTS -1"), ResourceError, "claims"),
        ((b"POINTS 20", b"POINTS many"), FormatError, "number"),
        ((b"SIZE 2 4 4 4 4", b"SIZE 2 4 4 4"), FormatError, "fields"),
        ((b"SIZE 2 4 4 4 4", b"SIZE 2 4 3 4 4"), FormatError, "SIZE 3"),
        ((b"COUNT 1 1 1 1 3", b"COUNT 1 1 1 1 99999999"), FormatError, "COUNT"),
        ((b"FIELDS intensity x y z normal", b"FIELDS intensity x y w normal"), FormatError, "z"),
        ((b"DATA binary", b"DATA zipped"), FormatError, "DATA zipped"),
        ((b"VERSION 0.7", b"VARSION 0.7"), FormatError, "header line"),
    ],
)
def test_faults_of_a_pcd_header(points, change, error, match):
    data = pcd_bytes(points[:20]).replace(*change)
    with pytest.raises(error, match=match):
        parse_pcd(data)


def test_a_pcd_that_unpacks_to_terabytes_is_refused():
    data = pcd_bytes(scan(n=20), "binary_compressed").replace(b"POINTS 20", b"POINTS 60000000")
    with pytest.raises(FormatError, match="packed"):
        parse_pcd(data)


def test_npy_pipe_gives_each_array_in_turn(points):
    others = [
        points.astype(np.float32),
        np.asfortranarray(points[:5]),
        np.column_stack([points, points])[:7].astype(">f8"),
        np.arange(9).reshape(3, 3),
        np.empty((0, 3)),
    ]
    frames = list(frames_of_npy(io.BytesIO(npy_bytes(points, *others))))
    np.testing.assert_array_equal(frames[0].read(), points)
    for frame, array in zip(frames[1:], others, strict=True):
        xyz = frame.read()
        assert xyz.dtype == np.float64
        np.testing.assert_array_equal(xyz, array[:, :3])


def test_an_array_that_is_no_scan_is_skipped(points):
    bad = [points[0], points[:, :2], np.array(["a", "b"]), np.zeros((2, 3, 3)), np.zeros((2, 4000))]
    frames = list(frames_of_npy(io.BytesIO(npy_bytes(*bad, points))))
    for frame in frames[:-1]:
        with pytest.raises(FormatError) as caught:
            frame.read()
        assert caught.value.code == "E_NOT_SCAN"
    np.testing.assert_array_equal(frames[-1].read(), points)


def test_every_truncation_of_a_pipe_is_named(points):
    data = npy_bytes(points[:4], points[:2])
    first = len(npy_bytes(points[:4]))
    for end in range(1, len(data)):
        if end == first:
            continue
        with pytest.raises(TruncatedError, match="byte"):
            list(frames_of_npy(io.BytesIO(data[:end])))


def test_bytes_that_are_no_array_end_the_pipe(points):
    frames = frames_of_npy(io.BytesIO(npy_bytes(points) + b"hello, world"))
    next(frames)
    with pytest.raises(FormatError, match=f"byte {len(npy_bytes(points))}: no NumPy array"):
        next(frames)


def test_pickles_and_huge_claims_are_refused(points):
    stream = io.BytesIO()
    np.save(stream, np.array([{}], object), allow_pickle=True)
    with pytest.raises(FormatError, match="skipped"):
        list(frames_of_npy(io.BytesIO(stream.getvalue())))
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999, 3), }"
    huge = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    with pytest.raises(FormatError, match="no scan"):
        list(frames_of_npy(io.BytesIO(huge)))


@given(st.integers(0, 127), st.integers(0, 255))
@settings(max_examples=150, deadline=None)
def test_a_changed_header_byte_is_an_error_or_another_array(place, value):
    data = bytearray(npy_bytes(scan(n=12), scan(n=3)))
    data[place] = value
    code = "none"
    try:
        for frame in frames_of_npy(io.BytesIO(bytes(data))):
            assert frame.read().shape[1] == 3
    except FormatError as error:
        code = error.code
    assert code in ("none", "E_CORRUPT", "E_TRUNCATED", "E_NOT_SCAN")


def test_a_scan_is_given_before_the_next_is_written(points):
    """The reader of a live pipe takes no byte more than it needs."""
    read_end, write_end = os.pipe()
    got, is_there = [], threading.Event()

    def consume():
        with os.fdopen(read_end, "rb") as stream:
            for frame in frames_of_npy(stream):
                got.append(len(frame.read()))
                is_there.set()

    thread = threading.Thread(target=consume)
    thread.start()
    with os.fdopen(write_end, "wb") as stream:
        for n in (300, 20):
            stream.write(npy_bytes(points[:n]))
            stream.flush()
            assert is_there.wait(20)
            is_there.clear()
    thread.join(20)
    assert got == [300, 20]


def test_files_are_known_by_their_bytes(points, tmp_path):
    (tmp_path / "a.bin").write_bytes(npy_bytes(points))
    (tmp_path / "b.npy").write_bytes(pcd_bytes(points))
    (tmp_path / "c.pcd").write_bytes((SAMPLES / "forest.laz").read_bytes())
    sizes = [len(f.read()) for f in frames_of_files(tmp_path / name for name in
                                                    ("a.bin", "b.npy", "c.pcd"))]  # fmt: skip
    assert sizes[:2] == [300, 300]
    assert sizes[2] > 1000


def test_files_that_are_no_scans(tmp_path):
    (tmp_path / "empty.pcd").touch()
    (tmp_path / "page.npy").write_bytes(b"<html>not found</html>" * 20)
    (tmp_path / "half.npy").write_bytes(npy_bytes(scan())[:500])
    (tmp_path / "half.pcd").write_bytes(pcd_bytes(scan())[:500])
    with pytest.raises(InputNotFoundError, match=r"none\.pcd"):
        read_frame(tmp_path / "none.pcd")
    with pytest.raises(InputError, match="not a file"):
        read_frame(tmp_path)
    for name, code in [
        ("empty.pcd", "E_NOT_SCAN"),
        ("page.npy", "E_NOT_SCAN"),
        ("half.npy", "E_TRUNCATED"),
        ("half.pcd", "E_TRUNCATED"),
    ]:
        with pytest.raises(FormatError, match=name) as caught:
            read_frame(tmp_path / name)
        assert caught.value.code == code


def test_poses_of_each_form(tmp_path):
    path = tmp_path / "poses.csv"
    half = np.sqrt(0.5)
    path.write_text(
        "x,y,z\n# a comment\n1,2,3\n"
        f"1 2 3 0 0 {half} {half}\n"
        "0,-1,0,1, 1,0,0,2, 0,0,1,3\n"
        "0 -1 0 1 1 0 0 2 0 0 1 3 0 0 0 1\n\n"
    )
    still, *turned = read_poses(path)
    np.testing.assert_array_equal(still.to_world(np.eye(3)), np.eye(3) + np.array([1, 2, 3]))
    for pose in turned:  # a quarter turn to the left
        np.testing.assert_allclose(
            pose.to_world(np.array([[1.0, 0, 0], [0, 1, 5]])), [[1, 3, 3], [0, 2, 8]], atol=1e-12
        )


@pytest.mark.parametrize(
    "line",
    ["1 2", "1 2 nan", "1 2 3 0 0 0 0", "2 0 0 0 0 1 0 0 0 0 1 0", "1 0 0 0 0 1 0 0 0 0 -1 0"],
)
def test_lines_that_are_no_poses(line, tmp_path):
    path = tmp_path / "poses.csv"
    path.write_text(f"0 0 0\n{line}\n")
    with pytest.raises(FormatError, match="line 2"):
        read_poses(path)
    path.write_text("0 0 0\na b c\n")
    with pytest.raises(FormatError, match="words"):
        read_poses(path)
    with pytest.raises(InputNotFoundError):
        read_poses(tmp_path / "none")
