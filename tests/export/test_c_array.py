"""The C header, compiled and asked: it must say what the volume says."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from making_exports import full_volume, toolkit_volume
from making_volumes import volume_of

import volatool as vt
from volatool.errors import OptionError, ResourceError
from volatool.export.c_array import _name
from volatool.formats.registry import open_volume

compiler = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")

PROGRAM = """\
#include <stdio.h>
#include "HEADER"
int main(void) {
    int level;
    uint32_t i;
    printf("%d %ld %lu %d %ld %lu\\n", TOWN_DEPTH, TOWN_GRID, TOWN_VOXELS, TOWN_HAS_METADATA,
           TOWN_EPSG, (unsigned long)((uintptr_t)town_vol % 8));
    printf("%.17g %.17g %.17g %.17g %.17g %.17g\\n", TOWN_CORNER_X, TOWN_CORNER_Y, TOWN_CORNER_Z,
           TOWN_SIDE, TOWN_CELL, TOWN_Z_RATIO);
    for (level = 1; level <= TOWN_DEPTH; level++)
        for (i = 0; i < town_blocks[level - 1]; i++)
            printf("%llu %llu\\n", (unsigned long long)town_word(level, i), @META@);
    fflush(stdout);
    fwrite(town_vol, 1, TOWN_VOL_SIZE, stderr);
    return 0;
}
"""


def compiled(folder, header, has_metadata, flags=()):
    """Return what a program prints that includes a header twice: numbers, and the bytes."""
    meta = "(unsigned long long)town_meta(level, i)" if has_metadata else "0ULL"
    text = PROGRAM.replace("@META@", meta).replace("HEADER", header)
    text = text.replace("#include <stdio.h>", f'#include <stdio.h>\n#include "{header}"')
    (folder / "main.c").write_text(text)
    command = ["gcc", "-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", *flags]
    command += ["-o", "main", "main.c"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    ran = subprocess.run([folder / "main"], capture_output=True, check=True)
    return ran.stdout.decode().splitlines(), ran.stderr


@compiler
@pytest.mark.parametrize("metadata", [True, False])
def test_a_program_finds_the_volume_in_it(tmp_path, metadata):
    volume = full_volume(metadata=metadata)
    vt.export_volume(volume, tmp_path / "town.h")
    (facts, numbers, *words), data = compiled(tmp_path, "town.h", metadata)
    assert facts.split() == ["3", "64", str(len(volume)), str(int(metadata)), "2994", "0"]
    cube = [*volume.cube.origin, volume.cube.side, volume.cell(), float(volume.crs.z_ratio)]
    assert [float(value) for value in numbers.split()] == cube
    found = np.array([row.split() for row in words], np.uint64)
    assert np.array_equal(found[:, 0], np.concatenate(volume.levels))
    if metadata:
        assert np.array_equal(found[:, 1], np.concatenate(volume.metadata_levels))
    again = open_volume(data)
    assert np.array_equal(again.keys(), volume.keys())
    assert again.crs == volume.crs


@compiler
def test_it_also_compiles_as_it_is_placed_by_others_and_as_a_later_c(tmp_path):
    vt.export_volume(full_volume(), tmp_path / "town.h")
    place = '-DTOWN_STORAGE=static const __attribute__((section(".rodata.map")))'
    for flags in ([place], ["-std=c11", "-O2"], ["-Wshadow", "-Wconversion", "-Wundef"]):
        compiled(tmp_path, "town.h", True, flags)


READER = """\
#include <stdio.h>
#define VOLA_IMPLEMENTATION
#include "vola.h"
#include "town.h"
int main(void) {
    static vola v;
    static vola_iter it;
    uint64_t word = 0;
    if (vola_open(&v, town_vol, TOWN_VOL_SIZE, VOLA_CHECK_ALL) != VOLA_OK) return 1;
    printf("%d %.17g %.17g\\n", v.depth, v.side, v.z_ratio);
    vola_begin(&it, &v, TOWN_DEPTH);
    while (vola_next(&it)) {
        vola_iter_metadata(&it, &word);
        printf("%d %d %d %llu\\n", it.x, it.y, it.z, (unsigned long long)word);
    }
    return 0;
}
"""
EMBEDDED = Path(__file__).resolve().parents[2] / "embedded"


@compiler
@pytest.mark.skipif(not (EMBEDDED / "vola.h").exists(), reason="no embedded/vola.h")
def test_the_reader_for_devices_reads_it(tmp_path):
    volume = full_volume()
    vt.export_volume(volume, tmp_path / "town.h")
    (tmp_path / "main.c").write_text(READER)
    command = ["gcc", "-std=c99", "-Wall", "-Wextra", "-Werror", f"-I{EMBEDDED}", "-o", "main"]
    done = subprocess.run(
        [*command, "main.c", "-lm"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    ran = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True)
    (depth, side, ratio), *rows = (line.split() for line in ran.stdout.splitlines())
    assert (int(depth), float(side)) == (volume.depth, volume.cube.side)
    assert float(ratio) == pytest.approx(float(volume.crs.z_ratio), rel=1e-15)
    found = np.array(rows, np.uint64)
    assert np.array_equal(found[:, :3], volume.voxels())
    assert np.array_equal(found[:, 3], volume.metadata())


@pytest.mark.skipif(shutil.which("g++") is None, reason="no g++")
def test_it_is_also_c_plus_plus(tmp_path):
    vt.export_volume(full_volume(), tmp_path / "town.h")
    main = "int main() { return town_vol[0] != 80 || town_word(1, 0) == 0; }\n"
    (tmp_path / "main.cpp").write_text('#include "town.h"\n' + main)
    command = ["g++", "-std=c++11", "-Wall", "-Wextra", "-Wold-style-cast", "-Werror", "-o", "main"]
    done = subprocess.run([*command, "main.cpp"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert subprocess.run([tmp_path / "main"], check=False).returncode == 0


def test_names_are_identifiers():
    names = {"town.2": "town_2", "2024": "v_2024", "int": "int_", "class": "class_", "_x": "v__x"}
    assert {stem: _name(None, stem) for stem in names} == names
    assert _name("rooms", "x") == "rooms"
    for wrong in ("", "2x", "a b", "while", "é"):
        with pytest.raises(OptionError, match="identifier"):
            _name(wrong, "x")


def test_nothing_of_the_crs_can_end_the_comment(tmp_path):
    from dataclasses import replace

    crs = replace(full_volume().crs, horizontal="*/ int x; /* ??/\n\\")
    volume = full_volume(info=replace(full_volume().info, crs=crs))
    (path,) = vt.export_volume(volume, tmp_path / "a.h").paths
    first = path.read_text().splitlines()[0]
    assert "*/" not in first
    assert "\\" not in first


def test_what_no_device_holds_is_refused(tmp_path):
    volume = full_volume()
    n_bytes = 80 + 16 * sum(map(len, volume.levels))
    for limit in (n_bytes - 1, n_bytes + 10):  # the levels alone fit the second
        with pytest.raises(ResourceError, match="--limit") as caught:
            vt.export_volume(volume, tmp_path / "a.h", limit=limit)
        assert caught.value.code == "E_SIZE"
    assert not list(tmp_path.iterdir())
    vt.export_volume(volume, tmp_path / "a.h", limit=10**6)


def test_a_toolkit_file_and_a_single_voxel(tmp_path):
    (path,) = vt.export_volume(toolkit_volume(), tmp_path / "a.h", name="rooms").paths
    assert "#define ROOMS_EPSG 28992L" in path.read_text()
    assert "rooms_meta" in path.read_text()
    (path,) = vt.export_volume(volume_of([(0, 0, 0)], 1), tmp_path / "b.h").paths
    assert "static const uint32_t b_blocks[B_DEPTH] = {1};" in path.read_text()
