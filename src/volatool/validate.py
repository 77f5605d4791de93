"""Check that a file is what it says: volumes, elevation models, reports."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from volatool.errors import CodedWarning, InputNotFoundError, VolatoolError
from volatool.naming import OUTPUT_SUFFIXES
from volatool.problems import Problem
from volatool.remote.path import path_of
from volatool.vola.volume import Volume

_REPAIRED = "W_ZERO_METADATA"


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
    path = path_of(path)
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


def validate_files(
    paths: Iterable[Path | str], *, whole_set: bool = False, size_limit: int | None = None
) -> list[ValidationReport]:
    """
    Check files, and those of one tile against each other.

    Parameters
    ----------
    paths : iterable of path
        As for `validate_file`. Files of one folder whose names differ only in the suffix
        (``x.vol.gz``, ``x.dvol.gz``, ``x.dem.tif``, ``x.stats.json``) belong to one tile.
    whole_set : bool
        Take in the other files of each tile that stand beside those given, and require those
        that a report names.
    size_limit : int, optional
        As for `validate_file`.

    Returns
    -------
    reports : list of ValidationReport
        One per file, in the order given, those taken in after the one that they belong to. Files
        that disagree have the problem ``E_MISMATCH``; those that are faulty by themselves are not
        compared.
    """
    found: dict[Path, ValidationReport] = {}
    for path in map(path_of, paths):
        for member in (path, *(_beside(path) if whole_set else ())):
            if member not in found:
                found[member] = validate_file(member, size_limit=size_limit)
    tiles: dict[Path, list[Path]] = {}
    for path in found:
        tiles.setdefault(path.parent / _stem(path.name), []).append(path)
    for members in tiles.values():
        for path, problem in _set_problems(members, found, whole_set, size_limit):
            report = found[path]
            found[path] = replace(report, problems=(*report.problems, problem))
    return list(found.values())


def _stem(name: str) -> str:
    """Return what the names of a tile's files begin with."""
    for suffix in sorted(OUTPUT_SUFFIXES, key=len, reverse=True):
        if name.lower().endswith(suffix):
            return name[: -len(suffix)]
    return name


def _beside(path: Path) -> Iterator[Path]:
    """Yield the other files of a file's tile that are there."""
    stem = _stem(path.name)
    for suffix in OUTPUT_SUFFIXES if stem != path.name else ():
        member = path.parent / (stem + suffix)
        if member != path and member.is_file():
            yield member


def _set_problems(
    members: list[Path],
    found: dict[Path, ValidationReport],
    whole_set: bool,
    size_limit: int | None,
) -> Iterator[tuple[Path, Problem]]:
    sound = [path for path in members if found[path].ok]
    reports = [path for path in sound if found[path].kind == "report"]
    if len(sound) < 2 and not (whole_set and reports):
        return
    from volatool.agreement import TileFiles, disagreements

    files = TileFiles(
        tuple(path for path in sound if found[path].kind in ("sparse", "dense")),
        tuple(path for path in sound if found[path].kind == "dem"),
        reports[0] if reports else None,
    )
    limit = {} if size_limit is None else {"size_limit": size_limit}
    yield from disagreements(files, complete=whole_set, **limit)


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
    from volatool.dem.recheck import check_dem

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
