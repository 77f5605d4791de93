"""Names, options and selection of exports; each format has its own file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from making_volumes import CUBE, INFO, random_volume, same, volume_of

import volatool as vt
from volatool.cube import Cube
from volatool.errors import InputError, OptionError, OutputExistsError
from volatool.export.cells import Places, cell_chunks, channels_by_name
from volatool.export.model import ExportOptions
from volatool.export.registry import FORMATS, SUFFIXES, exporter_for, exporter_of
from volatool.export.select import select
from volatool.model import Bounds
from volatool.vola.window import half_open


def stored(volume, folder) -> Path:
    """Return the path of a volume's file."""
    return vt.export_volume(volume, folder / "tile.vol").paths[0]


def test_each_format_is_told_by_its_suffix():
    for suffix, exporter in SUFFIXES.items():
        assert exporter_for(Path("a.b" + suffix.upper())) is exporter
    assert exporter_for(Path("x.vol1.vol")).name == "vol1"
    with pytest.raises(OptionError, match="tells no format"):
        exporter_for(Path("tile.docx"))
    with pytest.raises(OptionError, match="no format is called 'docx'"):
        exporter_of("docx")


def test_a_volume_goes_through_our_own_formats_unchanged(tmp_path):
    volume = random_volume()
    for name in ("vol", "vol.gz", "dvol", "dvol.gz"):
        done = vt.export_volume(volume, tmp_path / f"t.{name}")
        assert (done.format, done.n_voxels) == (name, len(volume))
        again = vt.open(done.paths[0])
        assert same(volume, again, metadata=not name.startswith("d"))
        assert again.info.crs == volume.info.crs


def test_names_beside_the_input_in_a_folder_and_as_given(tmp_path):
    path = stored(random_volume(), tmp_path)
    (tmp_path / "out").mkdir()
    named = [
        vt.export_volume(path, to="vol.gz").paths,
        vt.export_volume(path, tmp_path / "out", "dvol").paths,
        vt.export_volume(path, tmp_path / "new" / "thing.bin", "vol").paths,
        vt.export_volume(path, f"{tmp_path}/fresh/", "dvol").paths,
    ]
    expected = ["tile.vol.gz", "out/tile.dvol", "new/thing.bin", "fresh/tile.dvol"]
    assert named == [(tmp_path / name,) for name in expected]


def test_the_input_is_never_written_over_and_outputs_only_when_told(tmp_path):
    path = stored(random_volume(), tmp_path)
    before = path.read_bytes()
    link = tmp_path / "link.vol"
    link.symlink_to(path)
    for output in (None, path, link):
        with pytest.raises(OptionError, match="is the input"):
            vt.export_volume(path, output, "vol", overwrite=True)
    other = tmp_path / "other.vol"
    other.write_bytes(b"old")
    with pytest.raises(OutputExistsError):
        vt.export_volume(path, other)
    assert other.read_bytes() == b"old"
    vt.export_volume(path, other, overwrite=True)
    assert path.read_bytes() == before == other.read_bytes()


def test_options_that_mean_nothing_are_refused(tmp_path):
    volume = random_volume()
    with pytest.raises(OptionError, match="--slices means nothing for --to vol"):
        vt.export_volume(volume, tmp_path / "a.vol", slices="top")
    for wrong in (
        {"colour": "pink"},
        {"z": (2.0, 1.0)},
        {"limit": 0},
        {"frobnicate": 1},
        {"bounds": "x"},
    ):
        with pytest.raises(OptionError):
            vt.export_volume(volume, tmp_path / "a.vol", **wrong)
    with pytest.raises(OptionError, match="give --to"):
        vt.export_volume(volume)
    with pytest.raises(OptionError, match="without a file"):
        vt.export_volume(volume, to="vol")
    with pytest.raises(OptionError, match="level 9 is not in this volume"):
        vt.export_volume(volume, tmp_path / "a.vol", level=9)
    assert not list(tmp_path.iterdir())


def test_a_crop_without_voxels_is_an_error(tmp_path):
    with pytest.raises(InputError, match="no voxel is selected") as caught:
        vt.export_volume(random_volume(), tmp_path / "a.vol", bounds=Bounds(0, 0, 1, 1))
    assert caught.value.code == "E_EMPTY"
    assert not list(tmp_path.iterdir())


def test_a_crop_without_voxels_tells_where_they_are(tmp_path):
    path = stored(random_volume(), tmp_path)
    with pytest.raises(InputError, match=r"tile\.vol: no voxel .* z \S+ to \S+$"):
        vt.export_volume(path, to="npy", z=(1e6, 2e6))
    with pytest.raises(InputError, match="the volume: has no voxels"):
        vt.export_volume(volume_of([], 2), tmp_path / "a.npy")


def test_an_exporter_s_error_names_the_volume_once(tmp_path):
    path = stored(volume_of([(0, 0, 0)], 1, cube=Cube((0.0, 0.0, 0.0), 0.0)), tmp_path)
    for name in ("bt", "png", "nav2", "glb"):
        with pytest.raises(OptionError, match="no extent") as caught:
            vt.export_volume(path, to=name)
        assert caught.value.code == "E_CUBE"
        assert str(caught.value).startswith(f"{path}: the cube has no extent")
    path.unlink()
    with pytest.raises(InputError, match="no such file") as missing:
        vt.export_volume(stored(random_volume(), tmp_path), to="nav2", ground="no.tif")
    assert str(missing.value).startswith("no.tif: ")


def test_a_missing_package_says_how_to_get_it(tmp_path, monkeypatch):
    import volatool.export.registry as registry

    monkeypatch.setitem(FORMATS, "ply", replace(FORMATS["ply"], module="ply_gone"))

    def missing(name):
        raise ModuleNotFoundError(name="plyfile")

    monkeypatch.setattr(registry, "import_module", missing)
    with pytest.raises(OptionError, match=r"pip install 'volatool\[mesh\]'") as caught:
        vt.export_volume(random_volume(), tmp_path / "a", "ply")
    assert caught.value.code == "E_NO_EXTRA"


def test_selection_keeps_the_cells_that_meet_the_box():
    """Against the definition, cell by cell; z is in the vertical unit."""
    volume = random_volume()
    ratio = float(volume.crs.z_ratio)
    low = volume.cube.corners(volume.voxels(), volume.depth)
    high = low + volume.cell()
    box = (
        CUBE.origin[0] + 2,
        CUBE.origin[1] + 3,
        402.0,
        CUBE.origin[0] + 7,
        CUBE.origin[1] + 8,
        406,
    )
    chosen = select(
        volume,
        ExportOptions(bounds=Bounds(box[0], box[1], box[3], box[4]), z=(box[2], box[5])),
    )
    ends = np.array(box) * [1, 1, ratio, 1, 1, ratio]
    keep = np.all((low <= ends[3:]) & (high >= ends[:3]), axis=1)
    assert 0 < keep.sum() < len(keep)
    assert np.array_equal(chosen.voxels(), volume.voxels()[keep])
    assert np.array_equal(chosen.metadata(), volume.metadata()[keep])


def test_values_may_be_text():
    given = ExportOptions(bounds="0,1,2,3", above=("0", "2ft"), near="0", limit="1k")
    assert given.bounds == Bounds(0, 1, 2, 3) == ExportOptions(bounds=(0, 1, 2, 3)).bounds
    assert [str(length) for length in (*given.above, given.near)] == ["0", "2ft", "0"]
    assert given.limit == 1024


@pytest.mark.parametrize("quantizer", ["floor", "unknown"])
@pytest.mark.parametrize("level", [1, 2, 3])
def test_a_level_keeps_the_places_of_its_cells(quantizer, level):
    """A file of the original toolkit has a grid that can't simply be cut off at a level."""
    volume = random_volume(info=replace(INFO, quantizer=quantizer))
    chosen = select(volume, ExportOptions(level=level))
    assert chosen.depth == level
    assert np.array_equal(chosen.voxels(), volume.voxels(level))
    assert np.allclose(chosen.centers(), volume.centers(level), rtol=1e-15, atol=1e-9)
    centers = half_open(volume).centers()
    assert np.allclose(centers, volume.centers(), rtol=1e-15, atol=1e-9)


@pytest.mark.parametrize("quantizer", ["floor", "toolkit"])
@pytest.mark.parametrize("size", [1, 64, 1000])
def test_chunks_are_the_volume_in_pieces(quantizer, size):
    volume = random_volume(info=replace(INFO, quantizer=quantizer))
    chunks = list(cell_chunks(volume, size))
    assert np.array_equal(np.concatenate([one.cells for one in chunks]), volume.voxels())
    assert np.array_equal(np.concatenate([one.words for one in chunks]), volume.metadata())
    centers = np.concatenate([Places.of(volume).centers(one.cells) for one in chunks])
    assert np.allclose(centers, volume.centers(), rtol=1e-15, atol=1e-9)
    height = channels_by_name(volume)["height"]
    values = np.concatenate([one.channel(height) for one in chunks])
    assert np.array_equal(values, volume.channel("height"))


def test_chunks_of_a_root_without_voxels_and_of_one_level():
    empty = volume_of([], 1, metadata=False)
    assert list(cell_chunks(empty)) == []
    assert channels_by_name(empty) == {}
    full = volume_of([(x, y, z) for x in range(4) for y in range(4) for z in range(4)], 1)
    (chunk,) = cell_chunks(full)
    assert len(chunk) == 64


def test_what_was_put_right_when_the_file_was_read_is_told(tmp_path):
    from volatool.errors import CodedWarning

    warning = CodedWarning("W_EMPTY_BLOCKS", "level 2 stores empty blocks", 1)
    volume = random_volume(info=replace(INFO, warnings=(warning,)))
    assert vt.export_volume(volume, tmp_path / "a.vol").warnings == (warning,)


def test_no_memory_and_a_full_disk_leave_nothing_behind(tmp_path, monkeypatch):
    import volatool.export.vola as module

    def fail(error):
        def write(stream, volume, encoding):
            stream.write(b"begun")
            raise error

        return write

    for error, code in ((MemoryError(), "E_MEMORY"), (OSError(28, "No space left"), "E_WRITE")):
        monkeypatch.setattr(module, "write_volume", fail(error))
        with pytest.raises(vt.VolatoolError) as caught:
            vt.export_volume(random_volume(), tmp_path / "a.vol")
        assert caught.value.code == code
        assert not list(tmp_path.iterdir())


def test_pictures_do_not_mind_a_file_that_they_do_not_write(tmp_path):
    (tmp_path / "a.png").write_bytes(b"mine")
    paths = vt.export_volume(random_volume(), tmp_path / "a.png", slices="top").paths
    assert (tmp_path / "a.png").read_bytes() == b"mine"
    with pytest.raises(OutputExistsError):
        vt.export_volume(random_volume(), tmp_path / "a.png", slices="top")
    assert len(paths) == 3


def test_a_box_that_is_none_is_refused_and_four_numbers_are_one():
    volume = random_volume()
    x, y, _ = volume.cube.origin
    rectangle = (x, y, x + 1, y + 1)
    window = volume.window(rectangle)
    assert window.shape == volume.window(Bounds(*rectangle)).shape
    for options, message in (
        ({"z": (float("nan"), 1)}, "z must be lowest, highest"),
        ({"z": (2, 1)}, "z must be lowest, highest"),
        ({"z": 3}, "z must be lowest, highest"),
        ({"bounds": (0, 0, 1)}, "bounds must be left"),
        ({"bounds": (1, 0, 0, 0)}, "bounds must be left"),
        ({"bounds": "here"}, "bounds must be left"),
        ({"bounds": (0, 0, 1, 1)}, r"outside the cube: it has x \S+ to"),
        ({"level": 0}, "level 0"),
    ):
        with pytest.raises(OptionError, match=message):
            volume.window(**options)
    for options in ({"z": 5}, {"z": ("a", "b")}, {"level": 2.5}, {"level": "2"}):
        with pytest.raises(OptionError, match="must be"):
            ExportOptions(**options)
