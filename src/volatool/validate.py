"""Check that a file is what it says: volumes, elevation models, reports."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from volatool.errors import CodedWarning, InputNotFoundError, VolatoolError
from volatool.vola.volume import Volume

_OFFSET = re.compile(r"offset (\d+)")
_REPAIRED = "W_ZERO_METADATA"


@dataclass(frozen=True, slots=True)
class Problem:
    """
    One thing that is wrong.

    Parameters
    ----------
    code : str
        Stable code, ``E_...``.
    message : str
        What was expected and what was found.
    offset : int or None
        Byte of the (unpacked) file.
    """

    code: str
    message: str
    offset: int | None = None

    def __str__(self) -> str:
        return f"{self.code}: {self.message}"

    @classmethod
    def of(cls, error: VolatoolError) -> Problem:
        """Return the problem that an error tells of."""
        found = _OFFSET.findall(str(error))
        return cls(error.code, str(error), int(found[-1]) if found else None)


@dataclass(frozen=True, slots=True)
class ValidationReport:
    """
    The result for one file.

    Parameters
    ----------
    path : str
        The file.
    kind : str
        ``"sparse"``, ``"dense"``, ``"dem"``, ``"report"``, ``"index"`` or ``"unknown"``.
    problems : tuple of Problem
        What is wrong; empty when all is well.
    warnings : tuple of CodedWarning
        What is suspicious, but can be read.
    """

    path: str
    kind: str
    problems: tuple[Problem, ...] = ()
    warnings: tuple[CodedWarning, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.problems

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON object."""
        return {
            "path": self.path,
            "kind": self.kind,
            "ok": self.ok,
            "problems": [
                {"code": problem.code, "message": problem.message, "offset": problem.offset}
                for problem in self.problems
            ],
            "warnings": [warning.to_dict() for warning in self.warnings],
        }


def validate_file(path: Path | str, *, size_limit: int | None = None) -> ValidationReport:
    """
    Read a file to its end and check all that can be checked.

    Parameters
    ----------
    path : path
        A VOLA file (gzip or not), an elevation model (``.tif``), a report (``.json``) or an index
        (``.vola``).
    size_limit : int, optional
        Bytes of a volume that may be unpacked or kept in memory; that of `open_volume` by default.

    Returns
    -------
    report : ValidationReport
        Structure, counts and checksums of volumes; elevation models and reports as their modules
        check them. A file that can't be read is a report with a problem, not an error.
    """
    path = Path(path)
    name = path.name.lower()
    try:
        if name.endswith((".tif", ".tiff")):
            return ValidationReport(str(path), "dem", tuple(_dem_problems(path)))
        if name.endswith(".json"):
            return ValidationReport(str(path), "report", tuple(_report_problems(path)))
        if name.endswith(".vola"):
            return ValidationReport(str(path), "index", tuple(_index_problems(path)))
        return _volume_report(path, size_limit)
    except VolatoolError as error:
        return ValidationReport(str(path), _kind_of(name), (Problem.of(error),))


def _kind_of(name: str) -> str:
    if name.endswith((".tif", ".tiff")):
        return "dem"
    if name.endswith(".json"):
        return "report"
    if name.endswith(".vola"):
        return "index"
    name = name.removesuffix(".gz")
    return {".vol": "sparse", ".dvol": "dense"}.get(Path(name).suffix, "unknown")


def _volume_report(path: Path, size_limit: int | None) -> ValidationReport:
    from volatool.formats.registry import open_volume, read_info

    limit = {} if size_limit is None else {"size_limit": size_limit}
    volume = open_volume(path, **limit)
    info = read_info(path, **limit)
    kind = ("sparse", "dense")[info.header.mode]
    problems = [
        Problem("E_CORRUPT", f"{path}: {warning.message}")
        for warning in volume.info.warnings
        if warning.code == _REPAIRED
    ]
    if info.trailer is not None and info.trailer.get("voxels") != volume.n_voxels:
        problems.append(
            Problem(
                "E_CORRUPT",
                f"{path}: the trailer tells of {info.trailer.get('voxels')} voxels, "
                f"there are {volume.n_voxels}",
            )
        )
    warnings = [item for item in volume.info.warnings if item.code != _REPAIRED]
    warnings += _suspicions(path, kind, volume)
    return ValidationReport(str(path), kind, tuple(problems), tuple(warnings))


def _suspicions(path: Path, kind: str, volume: Volume) -> Iterator[CodedWarning]:
    named = _kind_of(path.name.lower())
    if named not in (kind, "unknown"):
        yield CodedWarning("W_SUFFIX", f"the file is {kind}, its name says {named}")
    if volume.metadata_levels is not None and kind == "sparse":
        n_zero = sum(len(words) - int(np.count_nonzero(words)) for words in volume.metadata_levels)
        if n_zero:
            yield CodedWarning(
                "W_ZERO_WORDS",
                "metadata words of zero; tools like the original would drop them",
                n_zero,
            )


def _dem_problems(path: Path) -> Iterator[Problem]:
    if not path.exists():
        raise InputNotFoundError(f"{path}: no such file")
    from volatool.dem.geotiff import check_dem

    for code, message, offset in check_dem(path):
        yield Problem(code, f"{path}: {message}", offset)


def _report_problems(path: Path) -> Iterator[Problem]:
    from volatool.report import Report, schema

    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputNotFoundError(f"{path}: no such file") from error
    except (OSError, ValueError, RecursionError) as error:
        yield Problem("E_NOT_REPORT", f"{path}: not JSON: {error}")
        return
    Report.from_dict(document)
    import jsonschema

    for fault in jsonschema.Draft202012Validator(schema()).iter_errors(document):
        yield Problem("E_NOT_REPORT", f"{path}: {fault.json_path}: {fault.message}")


def _index_problems(path: Path) -> Iterator[Problem]:
    """Tell files that an index names and are not there, or are not as it says."""
    from volatool.formats.registry import read_info
    from volatool.formats.vola_index import entry, read_index

    for one in read_index(path).files:
        if one.path is None:
            yield Problem("E_NOT_FOUND", f"{path}: {one.filename} is not there")
            continue
        try:
            header = read_info(one.path).header
        except VolatoolError as error:
            yield Problem.of(error)
            continue
        expected = entry(one.filename, header, None)
        for key in ("bbox", "crs", "depth", "nbits"):
            told = one.content.get(key)
            if told != expected[key] and not (told is None and key in ("depth", "nbits")):
                yield Problem(
                    "E_CORRUPT",
                    f"{path}: {one.filename}: {key} is {told} in the index, {expected[key]} in "
                    "the file; index the folder again",
                )
