"""The golden files of the original toolkit, for the tests that need them."""

from __future__ import annotations

import gzip
import hashlib
import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

N_CASES = 168
N_FAILURES = 9


@cache
def expected(shared: Path) -> dict[str, Any]:
    """Return expected.json."""
    document: dict[str, Any] = json.loads((shared / "golden" / "expected.json").read_text())
    assert document["format"] == "vola-golden-1"
    assert len(document["cases"]) == N_CASES
    assert len(document["writer_failures"]) == N_FAILURES
    return document


def stored(shared: Path, case: dict[str, Any]) -> Path:
    """Return the file of a case."""
    return shared / "golden" / "files" / case["stored_as"]


def unpacked(path: Path) -> bytes:
    """Return a file's bytes without gzip around them."""
    data = path.read_bytes()
    return gzip.decompress(data) if path.suffix == ".gz" else data


def input_path(shared: Path, name: str) -> Path:
    """Return the input of a case."""
    return shared / "golden" / expected(shared)["inputs"][name]["stored_as"]


def sha256(array: Any, dtype: str) -> str:
    """Return the hash of an array's bytes as the expectations have it."""
    return hashlib.sha256(np.ascontiguousarray(array).astype(dtype).tobytes()).hexdigest()
