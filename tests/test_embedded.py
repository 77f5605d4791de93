"""The C reader embedded/vola.h: against the test vectors, mutated files, and volatool's reader."""

from __future__ import annotations

import gzip
import json
import os
import random
import re
import shutil
import struct
import subprocess
import zlib
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import golden_cases as golden
import making_volumes as making
import numpy as np
import pytest

from volatool.errors import VolatoolError
from volatool.formats import trailer
from volatool.formats.registry import open_volume

TOP = Path(__file__).resolve().parents[1]
VECTORS = TOP / "docs" / "vectors"
EMBEDDED = TOP / "embedded"
COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
COMPILER = next(iter(COMPILERS), None)
STRICT = ["-Wall", "-Wextra", "-Wpedantic", "-Werror"]
SANITIZED = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
QUANTIZERS = ("unknown", "floor", "toolkit")
N_MUTATED = 10_000

pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")


def compiled(target: Path, *arguments: str | Path, compiler: str | None = None) -> None:
    """Run the compiler; what it says is the failure's message."""
    done = subprocess.run(
        [str(compiler or COMPILER), *map(str, arguments), "-o", str(target)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, ""), done.stderr


@pytest.fixture(scope="module", params=COMPILERS)
def driver(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the test driver, compiled by each compiler that is there, with sanitizers."""
    target = tmp_path_factory.mktemp("embedded") / "driver"
    options = ["-std=c99", "-O1", "-g", *STRICT, *SANITIZED]
    compiled(target, *options, EMBEDDED / "driver.c", compiler=request.param)
    return target


def run(driver: Path, mode: str, files: Iterable[bytes]) -> bytes:
    """Return what the driver answers; a sanitizer's report is a failure."""
    done = subprocess.run(
        [driver, mode],
        input=b"".join(struct.pack("<I", len(data)) + data for data in files),
        capture_output=True,
        check=False,
        env={**os.environ, "ASAN_OPTIONS": "detect_leaks=0", "UBSAN_OPTIONS": "print_stacktrace=1"},
    )
    assert (done.returncode, done.stderr) == (0, b""), done.stderr.decode(errors="replace")
    return done.stdout


def python_code(data: bytes) -> str:
    """Return the code with which volatool refuses a file, OK if it does not."""
    try:
        open_volume(data)
    except VolatoolError as error:
        return error.code
    return "OK"


def vectors() -> list[tuple[dict[str, Any], bytes]]:
    """Return the vectors, gzip unpacked."""
    found = []
    for path in sorted(VECTORS.glob("*vol*.json")):
        data = path.with_suffix("").read_bytes()
        data = gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data
        found.append((json.loads(path.read_text(encoding="utf-8")), data))
    return found


# --------------------------------------------------------------------------------- compilers


@pytest.mark.parametrize("define", [[], ["-DVOLA_STATIC"], ["-DVOLA_NO_DOUBLE"]], ids=str)
@pytest.mark.parametrize("language", [["-std=c99"], ["-xc++", "-std=c++11"]], ids=str)
def test_it_compiles_without_a_warning(
    tmp_path: Path, define: list[str], language: list[str]
) -> None:
    """As C99 and as C++, with and without floating point, functions extern and static."""
    if "-xc++" in language and not shutil.which("g++"):
        pytest.skip("there is no C++ compiler")
    source = tmp_path / "unit.c"
    source.write_text('#define VOLA_IMPLEMENTATION\n#include "vola.h"\n#include "vola.h"\n')
    more = ["-Wconversion", "-Wshadow", f"-I{EMBEDDED}", "-c"]
    compiled(tmp_path / "unit.o", *language, "-O2", *STRICT, *more, *define, source)


def test_it_needs_nothing_but_memory_functions(tmp_path: Path) -> None:
    """No allocation, no input, no output: the object file asks for nothing else."""
    if not shutil.which("nm"):
        pytest.skip("there is no nm")
    source = tmp_path / "unit.c"
    source.write_text('#define VOLA_IMPLEMENTATION\n#include "vola.h"\n')
    compiled(tmp_path / "unit.o", "-std=c99", "-Os", f"-I{EMBEDDED}", "-c", source)
    asked = subprocess.run(["nm", "-u", tmp_path / "unit.o"], capture_output=True, text=True)
    allowed = {"memcmp", "memcpy", "memset", "strlen", "__stack_chk_fail", "_GLOBAL_OFFSET_TABLE_"}
    assert set(asked.stdout.replace(" U ", "").split()) <= allowed


def test_it_is_the_same_on_32_bits(tmp_path: Path) -> None:
    """Where the compiler can make such programs: the vectors, sizes beyond size_t too."""
    try:
        compiled(tmp_path / "driver", "-m32", "-std=c99", "-msse2", "-mfpmath=sse",
                 EMBEDDED / "driver.c")  # fmt: skip
    except AssertionError:
        pytest.skip("the compiler makes no programs of 32 bits here")
    test_the_vectors_are_read_as_they_say(tmp_path / "driver")
    test_points_fall_where_the_vectors_say(tmp_path / "driver")


def test_the_snippet_of_the_readme_compiles(tmp_path: Path) -> None:
    """As it stands, in a function."""
    text = (EMBEDDED / "README.md").read_text(encoding="utf-8")
    (snippet,) = re.findall(r"^```c\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    start, rest = snippet.split("\n\n", 1)
    around = "void brake(void);\nextern const char flash_address[];\nextern size_t flash_size;\n"
    source = tmp_path / "unit.c"
    source.write_text(f"{start}\n{around}void drive(void);\nvoid drive(void) {{\n{rest}}}\n")
    compiled(tmp_path / "unit.o", "-std=c99", *STRICT, f"-I{EMBEDDED}", "-c", source)


def test_the_example_answers(tmp_path: Path) -> None:
    """It finds a full block, an empty place, a damaged file and a missing one."""
    compiled(tmp_path / "example", "-std=c99", *STRICT, *SANITIZED, EMBEDDED / "example.c")

    def ask(*arguments: object) -> tuple[int, str, str]:
        done = subprocess.run(
            [tmp_path / "example", *map(str, arguments)], capture_output=True, text=True
        )
        return done.returncode, done.stdout, done.stderr

    full = VECTORS / "sparse2-full-block.vol"
    status, said, _ = ask(full, 105, 209, 11)
    assert status == 0
    assert said.startswith("sparse, depth 2, cube 100 200 10 side 16\n")
    assert said.endswith("level 2: 64 cells of 1\noccupied\n")
    assert ask(full, 115, 209, 11)[1].endswith("empty\n")
    status, _, said = ask(VECTORS / "bad-crc-levels.vol")
    assert (status, said.split(":")[0]) == (6, "E_CORRUPT")
    assert ask(VECTORS / "sparse3-metadata.vol.gz")[2].startswith("E_NOT_VOLA")
    assert ask(tmp_path / "none.vol")[0] == 4
    assert ask()[0] == 2


# ----------------------------------------------------------------------------------- vectors


def stored(level: dict[str, Any], name: str) -> list[str]:
    return [level[name].get(str(number), "0" * 16) for number in range(level["count"])]


def check_vector(vector: dict[str, Any], found: dict[str, Any]) -> None:
    """Hold one answer against the expected JSON."""
    assert found["status"] == vector.get("error", "OK"), vector["file"]
    if "error" in vector:
        return
    header = vector["header"]
    for key in ("mode", "depth", "nbits", "crs", "lat", "lon", "box"):
        assert found[key] == header[key]
    assert found["trailer"] == vector["trailer"]
    assert QUANTIZERS[found["quantizer"]] == vector["quantizer"]
    names = ("W_ZERO_METADATA", "W_EMPTY_BLOCKS")
    assert [n for bit, n in enumerate(names) if found["warnings"] >> bit & 1] == vector["warnings"]
    top, bottom = map(int, vector["z_ratio"].split("/"))
    assert found["z_ratio"] == top / bottom
    top, bottom = map(int, vector["cube"]["side"].split("/"))
    assert found["side"] == top / bottom
    assert found["corner"] == header["box"][:3]
    assert [voxel[:3] for voxel in found["voxels"]] == vector["voxels"]
    expected = vector["voxel_metadata"] or [None] * len(vector["voxels"])
    assert [voxel[3] for voxel in found["voxels"]] == expected
    np.testing.assert_allclose(
        np.reshape([voxel[4:] for voxel in found["voxels"]], (-1, 3)),
        np.reshape(vector["centres"], (-1, 3)),
        rtol=1e-14,
        atol=1e-12,
    )
    assert len(found["levels"]) == len(vector["levels"])
    for level, told in zip(found["levels"], vector["levels"], strict=True):
        bits = sum(int(word, 16).bit_count() for word in told["words"])
        assert level["cells"] == bits
        if header["mode"]:
            continue  # strips; the voxels above are their bits
        assert stored(level, "words") == told["words"]
        if told["metadata"] is not None:
            assert stored(level, "metadata") == told["metadata"]


def test_the_vectors_are_read_as_they_say(driver: Path) -> None:
    """Header, levels, voxels, metadata, trailer, cube; damaged ones refused with their code."""
    cases = vectors()
    answers = run(driver, "dump", (data for _, data in cases)).decode().split("\n{")
    # the JSON of a trailer may have line breaks of its own
    answers = [answer if i == 0 else "{" + answer for i, answer in enumerate(answers)]
    assert len(answers) == len(cases)
    for (vector, _), answer in zip(cases, answers, strict=True):
        check_vector(vector, json.loads(answer))


def test_points_fall_where_the_vectors_say(driver: Path) -> None:
    """With both rules, on faces, outside, in another unit of height."""
    cases = [(vector, data) for vector, data in vectors() if vector.get("points")]
    asked = [[point["xyz"] for point in vector["points"]] for vector, _ in cases]
    files = []
    for (_, data), xyz in zip(cases, asked, strict=True):
        files += [data, np.array(xyz, "<f8").tobytes()]
    found = np.frombuffer(run(driver, "points", files), "<i4").reshape(-1, 4).tolist()
    expected = [
        [*(point["voxel"] or (-1, -1, -1)), int(point["contained"])]
        for vector, _ in cases
        for point in vector["points"]
    ]
    assert found == expected


def test_without_floating_point_the_same_cells_are_there(tmp_path: Path) -> None:
    """VOLA_NO_DOUBLE: what only numbers tell is not checked, everything else is."""
    options = ["-std=c99", "-O1", *STRICT, *SANITIZED, "-DVOLA_NO_DOUBLE"]
    compiled(tmp_path / "driver", *options, EMBEDDED / "driver.c")
    cases = vectors()
    output = run(tmp_path / "driver", "voxels", (data for _, data in cases))
    at, unchecked = 0, set()
    for vector, _ in cases:
        status, n = struct.unpack_from("<IQ", output, at)
        rows = [struct.unpack_from("<3iQ", output, at + 12 + 20 * i) for i in range(n)]
        at += 12 + 20 * n
        if "error" in vector:
            unchecked |= set() if status else {vector["file"]}
            continue
        assert status == 0
        assert [list(row[:3]) for row in rows] == vector["voxels"]
        if vector["voxel_metadata"] is not None:
            assert [f"{row[3]:016x}" for row in rows] == vector["voxel_metadata"]
    assert unchecked == {"bad-box-huge.vol", "bad-cube.vol"}
    chance = random.Random(6)
    files = seeds()
    codes = run(tmp_path / "driver", "exercise", [mutated(files, chance) for _ in range(2000)])
    assert len(codes.split()) == 2000


# ----------------------------------------------------------------------------- mutated files


def seeds() -> list[bytes]:
    """Return files to be damaged: the vectors, a larger one of each kind, without trailers too."""
    small = [data for _, data in vectors() if len(data) < 5000]
    larger = making.random_volume(4, 300)
    for mode, metadata in [(0, True), (0, False)]:
        volume = making.volume_of(
            {tuple(map(int, cell)) for cell in larger.voxels()}, 4, metadata=metadata
        )
        small.append(making.written(volume, mode))
    without = [data[: data.find(b"VOLATRL1")] for data in small if b"VOLATRL1" in data]
    return small + without


def mutated(files: list[bytes], chance: random.Random) -> bytes:
    """Return one of the files with a few changes."""
    data = bytearray(chance.choice(files))
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        kind = chance.randrange(8)
        at = chance.randrange(len(data) + 1)
        if kind <= 1 and data:  # a bit
            data[at % len(data)] ^= 1 << chance.randrange(8)
        elif kind == 2:  # cut
            del data[at:]
        elif kind == 3:  # bytes out, or in
            del data[at : at + chance.choice((1, 4, 8, 16))]
        elif kind == 4:
            data[at:at] = chance.randbytes(chance.choice((1, 8, 40)))
        elif kind == 5:  # another file's end
            other = chance.choice(files)
            data = data[:at] + other[chance.randrange(len(other) + 1) :]
        elif kind == 6 and len(data) >= 80:  # a field of the header
            offset, size = chance.choice(
                ((0, 4), (4, 2), (6, 1), (7, 1), (7, 1), (8, 4), (12, 4), (32, 8), (56, 8), (72, 8))
            )
            value = chance.choice((0, 1, 2, 3, 5, 15, 16, 255, 2**31, 2**52, 2**64 - 1))
            data[offset : offset + size] = (value % 256**size).to_bytes(size, "little")
        elif kind == 7 and len(data) > 88:  # a word
            place = 80 + 8 * chance.randrange((len(data) - 80) // 8)
            word = chance.choice((0, 1, 2**63, 2**64 - 1, chance.getrandbits(64)))
            data[place : place + 8] = word.to_bytes(8, "little")
    return bytes(data)


def test_ten_thousand_mutated_files_are_read_or_refused(driver: Path) -> None:
    """No sanitizer has anything to say, no answer contradicts another, the codes are volatool's."""
    chance = random.Random(4)
    files = seeds()
    cases = [mutated(files, chance) for _ in range(N_MUTATED)]
    codes = run(driver, "exercise", cases).decode().split()
    assert len(codes) == N_MUTATED
    count = Counter(codes)
    assert min(count[code] for code in ("OK", "E_NOT_VOLA", "E_TRUNCATED", "E_CORRUPT")) > 400
    assert count["E_SIZE"] > 10
    assert set(count) == {"OK", "E_NOT_VOLA", "E_TRUNCATED", "E_CORRUPT", "E_SIZE"}
    for data, code in zip(cases, codes, strict=True):
        if data[:2] != b"\x1f\x8b":
            assert python_code(data) == code, data.hex()


def test_mutated_json_with_right_checksums_is_read_or_refused(driver: Path) -> None:
    """What volatool takes of it the C reader takes too; it does not look at all of the JSON."""
    chance = random.Random(5)
    bits = (
        b'"',
        b"\\",
        b"{",
        b"}",
        b"[",
        b"]",
        b",",
        b":",
        b"null",
        b"-",
        b"9" * 30,
        b"/",
        b" ",
        b"",
    )
    bodies = []
    for _, data in vectors():
        at = data.find(b"VOLATRL1")
        if at > 0 and len(data) > at + 32 and len(data) < 5000:
            bodies.append((data[:at], data[at + 12 : -20]))
    files = []
    for _ in range(3000):
        body, text = chance.choice(bodies)
        changed = bytearray(text)
        for _ in range(chance.choice((1, 1, 2, 4))):
            at = chance.randrange(len(changed) + 1)
            changed[at : at + chance.choice((0, 1, 1, 5))] = chance.choice(bits)
        files.append(body + trailer.frame(bytes(changed), zlib.crc32(body)))
    codes = run(driver, "exercise", files).decode().split()
    accepted = [code == "OK" for code in codes]
    ours = [python_code(data) == "OK" for data in files]
    assert 100 < sum(ours) <= sum(accepted) < len(files) - 300
    assert all(c or not python for c, python in zip(accepted, ours, strict=True))


def test_every_cut_of_a_file_is_told_as_volatool_does(driver: Path) -> None:
    """Sparse with metadata and trailer, byte by byte."""
    (data,) = (data for vector, data in vectors() if vector["file"] == "sparse2-feet.vol")
    cuts = [data[:length] for length in range(len(data))]
    codes = run(driver, "exercise", cuts).decode().split()
    assert codes == [python_code(cut) for cut in cuts]


# ---------------------------------------------------------------------------------- real data


@pytest.mark.shared
def test_the_golden_files_are_read_as_expected(driver: Path, shared: Path) -> None:
    """All files of the original toolkit: voxels and the word of each one's block or strip."""
    cases = [case for case in golden.expected(shared)["cases"] if case["file_bytes"] < 3_000_000]
    assert len(cases) > 150
    output = run(driver, "voxels", (golden.unpacked(golden.stored(shared, c)) for c in cases))
    at = 0
    row = np.dtype([("cell", "<i4", 3), ("word", "<u8")])
    for case in cases:
        status, n = struct.unpack_from("<IQ", output, at)
        rows = np.frombuffer(output, row, n, at + 12)
        at += 12 + n * row.itemsize
        dropped = case.get("dropped_zero_meta_words")
        if dropped and status:
            continue
        assert status == 0, case["file"]
        x, y, z = rows["cell"].T
        rows = rows[np.lexsort((z, y, x))]
        assert n == case["voxel_count"]
        assert golden.sha256(rows["cell"], "<i4") == case["voxels_sha256"]
        if "voxel_words_sha256" in case:
            assert golden.sha256(rows["word"], "<u8") == case["voxel_words_sha256"]
    assert at == len(output)


@pytest.mark.parametrize("mode", [0, 1])
@pytest.mark.parametrize("depth", [2, 4])
def test_random_points_answer_as_volatool_does(driver: Path, mode: int, depth: int) -> None:
    """Cells and voxels at 20,000 places, z in another unit; bit for bit, on faces too."""
    volume = making.random_volume(depth, 400, metadata=bool(depth % 4))
    corner, side = np.array(volume.cube.origin), volume.cube.side
    chance = np.random.default_rng(depth)
    xyz = corner + side * chance.uniform(-0.02, 1.02, (20_000, 3))
    faces = corner + side / 4**depth * chance.integers(0, 4**depth + 1, (20_000, 3))
    xyz = np.vstack([xyz, faces])
    xyz[:, 2] /= float(volume.crs.z_ratio)
    found = run(driver, "points", [making.written(volume, mode), xyz.astype("<f8").tobytes()])
    rows = np.frombuffer(found, "<i4").reshape(-1, 4)
    cells = volume.cell_indices(xyz)
    np.testing.assert_array_equal(rows[:, :3], cells)
    np.testing.assert_array_equal(rows[:, 3], volume.contains_cells(cells))


@pytest.mark.shared
def test_a_real_tile_answers_as_volatool_does(driver: Path, shared: Path, tmp_path: Path) -> None:
    """Feet in the plane, its CRS from the file; random points and points near the surface."""
    import volatool

    report = volatool.convert(shared / "tiles" / "4_6_crop.las", outdir=tmp_path, dem=False)
    (path,) = (path for path in report.paths if path.name.endswith(".vol.gz"))
    volume = volatool.open(path)
    chance = np.random.default_rng(1)
    centres = volume.centers()[chance.integers(0, len(volume), 20_000)]
    xyz = np.vstack([centres, centres + chance.normal(0, volume.cell(), centres.shape)])
    found = run(driver, "points", [gzip.decompress(path.read_bytes()), xyz.astype("<f8").tobytes()])
    rows = np.frombuffer(found, "<i4").reshape(-1, 4)
    cells = volume.cell_indices(xyz)
    np.testing.assert_array_equal(rows[:, :3], cells)
    np.testing.assert_array_equal(rows[:, 3], volume.contains_cells(cells))
    assert rows[:20_000, 3].all()
    assert not rows[20_000:, 3].all()
