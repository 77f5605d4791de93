"""The test vectors of docs/format.md: made as they stand, read as they say, written again."""

from __future__ import annotations

import gzip
import importlib.util
import json
import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import making_volumes as making
import numpy as np
import pytest

from volatool.cube import Cube
from volatool.errors import VolatoolError
from volatool.formats import trailer
from volatool.formats.registry import open_volume, read_info
from volatool.vola.volume import Volume, VolumeInfo

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "vectors"
VECTORS = [
    json.loads(path.read_text(encoding="utf-8")) for path in sorted(FOLDER.glob("*vol*.json"))
]
GOOD = [vector for vector in VECTORS if "error" not in vector]
BAD = [vector for vector in VECTORS if "error" in vector]


def name(vector: dict[str, Any]) -> str:
    return str(vector["file"])


def hexes(words: Any) -> list[str]:
    return [f"{int(word):016x}" for word in words]


def test_there_are_vectors_of_every_kind() -> None:
    """The folder is there, small, and has nothing else in it."""
    assert len(GOOD) >= 18
    assert {vector["error"] for vector in BAD} == {
        "E_NOT_VOLA",
        "E_TRUNCATED",
        "E_CORRUPT",
        "E_SIZE",
    }
    files = {path.name for path in FOLDER.iterdir() if path.name != "__pycache__"}
    named = {name(vector) for vector in VECTORS}
    beside = {"README.md", "make.py", "twin.py", "EPSG-2994+6360.wkt"}
    assert files == named | {f"{each}.json" for each in named} | beside
    assert sum((FOLDER / each).stat().st_size for each in files) < 200_000


def test_the_generator_makes_them_again(tmp_path: Path) -> None:
    """It imports nothing of volatool, and the same bytes come out."""
    code = (FOLDER / "make.py").read_text() + (FOLDER / "twin.py").read_text()
    assert "import volatool" not in code
    assert "from volatool" not in code
    done = subprocess.run(
        [sys.executable, FOLDER / "make.py", tmp_path], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    made = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert len(made) == 2 * len(VECTORS)
    for each, data in made.items():
        assert (FOLDER / each).read_bytes() == data, each


@pytest.mark.parametrize("vector", GOOD, ids=name)
def test_a_vector_is_read_as_it_says(vector: dict[str, Any]) -> None:
    """Header, levels, voxels, metadata, cube, CRS, places of points."""
    path = FOLDER / name(vector)
    volume, info = open_volume(path), read_info(path)
    told = vector["header"]
    for field in ("mode", "depth", "nbits", "crs", "lat", "lon"):
        assert getattr(info.header, field) == told[field]
    assert list(info.header.box) == told["box"]
    assert info.trailer == vector["trailer"]
    exact = [f"{value.numerator}/{value.denominator}" for value in volume.cube.exact]
    assert exact == [*vector["cube"]["origin"], vector["cube"]["side"]]
    assert volume.crs.z_ratio == Fraction(vector["z_ratio"])
    assert volume.info.quantizer == vector["quantizer"]
    assert [warning.code for warning in volume.info.warnings] == vector["warnings"]
    for level, expected in enumerate(vector["levels"], 1):
        assert volume.n_blocks(level) == expected["blocks"]
        assert hexes(volume.levels[level - 1]) == expected["words"]
        assert volume.has_metadata == (expected["metadata"] is not None)
        if volume.has_metadata:
            assert hexes(volume.metadata_words(level)) == expected["metadata"]
    assert volume.voxels().tolist() == vector["voxels"]
    if vector["voxel_metadata"] is not None and told["mode"] == 0:
        assert hexes(volume.metadata()) == vector["voxel_metadata"]
    np.testing.assert_allclose(
        volume.centers(), np.reshape(vector["centres"], (-1, 3)), rtol=1e-14, atol=1e-12
    )
    for point in vector["points"]:
        place = point["voxel"] if point["voxel"] is not None else [-1, -1, -1]
        assert volume.cell_indices([point["xyz"]]).tolist() == [place], point
        assert volume.contains([point["xyz"]]).tolist() == [point["contained"]], point


def test_what_the_trailer_tells_of_the_crs_is_kept() -> None:
    """Nothing of a compound CRS in two units is lost."""
    (vector,) = (vector for vector in GOOD if name(vector) == "sparse2-feet.vol")
    crs, told = open_volume(FOLDER / name(vector)).crs, vector["trailer"]["crs"]
    for key in ("wkt2", "horizontal", "vertical", "epsg", "unit_xy", "unit_z", "source"):
        assert getattr(crs, key) == told[key]
    assert crs.metres_per_unit_xy == Fraction(told["metres_per_unit_xy"])
    assert crs.metres_per_unit_z == Fraction(told["metres_per_unit_z"])


@pytest.mark.parametrize("vector", BAD, ids=name)
def test_a_damaged_vector_is_refused_as_it_says(vector: dict[str, Any]) -> None:
    """With the code, and in one line."""
    with pytest.raises(VolatoolError) as caught:
        open_volume(FOLDER / name(vector))
    assert caught.value.code == vector["error"]
    assert "\n" not in str(caught.value)


@pytest.fixture
def twin(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The twin's module; the trailer names the same version as it does."""
    monkeypatch.setattr(trailer, "__version__", "0.1.0")
    spec = importlib.util.spec_from_file_location("twin", FOLDER / "twin.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.usefixtures("twin")
@pytest.mark.parametrize("vector", [v for v in GOOD if v["rewritten"]], ids=name)
def test_the_writer_makes_the_same_bytes(vector: dict[str, Any]) -> None:
    """From the volume that was read."""
    data = (FOLDER / name(vector)).read_bytes()
    if data[:2] == b"\x1f\x8b":
        data = gzip.decompress(data)
    volume = open_volume(data)
    again = making.written(volume, vector["header"]["mode"])
    if vector["header"]["mode"] and volume.has_metadata:
        # reading averages strips to blocks, writing blocks to strips: one is not the other's
        # inverse. The test below writes from the blocks that the twin had
        again, data = (clean(open_volume(bytes_)) for bytes_ in (again, data))
    assert again == data


def clean(volume: Volume) -> bytes:
    """Return a volume's cells and facts, without metadata, as a file."""
    return making.written(Volume(volume.levels, None, volume.cube, volume.info), 0)


@pytest.mark.parametrize("seed", [None, 7])
@pytest.mark.parametrize("depth", [1, 2, 3])
@pytest.mark.parametrize("mode", [0, 1])
def test_twin_and_writers_make_the_same_files(
    twin: Any, mode: int, depth: int, seed: int | None
) -> None:
    """Sparse and dense, with and without metadata, byte for byte."""
    tree = twin.Tree(twin.some_voxels(depth, 60, 300 + depth), depth, seed)
    origin, side = (10.5, -3.0, 0.0), 32.0
    start = twin.header(depth, twin.box_of(origin, side), mode=mode, nbits=int(seed is not None))
    cube = tuple(map(Fraction, (*origin, side)))
    what = twin.Dense(tree) if mode else tree
    stored = [64**level for level in range(depth)] if mode else tree.counts()
    content = twin.trailer_part(cube, stored, len(tree.voxels))
    body = start + (what.body() if mode else tree.sparse())
    expected = twin.framed(body, twin.canonical(content))
    words = [np.array(list(blocks.values()), np.uint64) for blocks in tree.blocks]
    metadata = None
    if tree.metadata is not None:
        metadata = tuple(np.array(list(each.values()), np.uint64) for each in tree.metadata)
    volume = Volume(tuple(words), metadata, Cube(origin, side), VolumeInfo())
    assert making.written(volume, mode) == expected
