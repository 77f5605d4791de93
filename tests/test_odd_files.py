"""Malformed and odd files: a valid output or one coded line, never a traceback or a huge claim."""

from __future__ import annotations

import json
import subprocess
import sys

import jsonschema
import pytest

from volatool.report import schema
from volatool.validate import validate_file

REFUSED = {
    "autzen_autzen-dd.las": "E_GEOGRAPHIC",
    "simple1_4.las": "E_GEOGRAPHIC",
    "las_1.2-with-color-clipped.las": "E_TRUNCATED",
    "las_garbage_nVariableLength.las": "E_TRUNCATED",
}
SALVAGEABLE = ["las_1.2-with-color-clipped.las", "las_garbage_nVariableLength.las"]

# the parent measures the child: resource usage of all its descendants
RUN = (
    "import resource, subprocess, sys\n"
    "done = subprocess.run(sys.argv[1:])\n"
    "peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss\n"
    "print(peak * 1024, file=sys.stderr)\n"
    "sys.exit(done.returncode)\n"
)


def convert(paths, folder, *options):
    """Convert in one process; return status, reports, lines of stderr and peak memory."""
    command = [sys.executable, "-c", RUN, sys.executable, "-m", "volatool_cli", "convert"]
    done = subprocess.run(
        [*command, *map(str, paths), "-o", str(folder), "--json", *options],
        capture_output=True,
        text=True,
        check=False,
        timeout=20 * len(paths),
    )
    *lines, peak = done.stderr.splitlines()
    return (
        done.returncode,
        [json.loads(line) for line in done.stdout.splitlines()],
        lines,
        int(peak),
    )


def test_every_odd_file_ends_well(shared, tmp_path):
    paths = sorted((shared / "odd").glob("*.la[sz]"))
    assert len(paths) >= 36
    status, reports, lines, peak = convert(paths, tmp_path / "out")
    assert status == 3
    assert peak < 1 << 30
    assert all(line.startswith(("E_", "W_")) for line in lines), lines
    assert len(reports) == len(paths)
    for path, report in zip(paths, reports, strict=True):
        jsonschema.validate(report, schema())
        expected = REFUSED.get(path.name)
        assert (report["error"] or {}).get("code") == expected, path.name
        if expected is None:
            assert report["resources"]["seconds"] < 20
    errors = [line for line in lines if line.startswith("E_")]
    assert len(errors) == len(REFUSED)
    outputs = list((tmp_path / "out").iterdir())
    assert not [output for output in outputs if output.name.startswith(".")]
    for output in outputs:
        assert validate_file(output).ok, output


@pytest.mark.parametrize("name", SALVAGEABLE)
def test_salvage_keeps_what_is_readable_and_says_so(name, shared, tmp_path):
    status, reports, _, _ = convert([shared / "odd" / name], tmp_path, "--salvage")
    assert status == 0
    assert reports[0]["status"] == "partial"
    assert "W_SALVAGED" in [warning["code"] for warning in reports[0]["warnings"]]


def test_a_readme_is_not_las(shared, tmp_path):
    status, reports, lines, _ = convert([shared / "odd" / "README.md"], tmp_path)
    assert (status, reports[0]["error"]["code"], len(lines)) == (4, "E_NOT_LAS", 1)
