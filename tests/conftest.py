"""What all tests share: the shared real data, and a kernel cache of the tests' own."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder of real tiles and golden files, from VOLATOOL_SHARED."""
    folder = os.environ.get("VOLATOOL_SHARED")
    if not folder:
        pytest.skip("VOLATOOL_SHARED is unset: the real tiles and golden files are not there")
    return Path(folder).resolve()
