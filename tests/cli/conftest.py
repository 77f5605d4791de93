"""Running the command line, in process and as a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SAMPLES = Path(__file__).resolve().parents[2] / "data_samples"


@pytest.fixture
def volatool(tmp_path):
    """Run ``volatool`` as a process in a folder of its own that has the sample tiles."""
    for sample in ("town.laz", "forest.laz"):
        (tmp_path / sample).symlink_to(SAMPLES / sample)

    def run(*arguments, **options):
        return subprocess.run(
            [sys.executable, "-m", "volatool_cli", *map(str, arguments)],
            capture_output=True,
            text=options.pop("text", True),
            cwd=tmp_path,
            env={**os.environ, **options.pop("env", {})},
            timeout=options.pop("timeout", 120),
            check=False,
            **options,
        )

    run.folder = tmp_path
    return run
