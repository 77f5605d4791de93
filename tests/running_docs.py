"""Taking code out of the documentation, and typing it into a shell."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

TOP = Path(__file__).resolve().parents[1]


def blocks(page, language):
    """The fenced blocks of a language, in order."""
    text = (TOP / page).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def put_command(folder):
    """Make ``bin/volatool`` in a folder, which runs the code at hand."""
    command = folder / "bin" / "volatool"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m volatool_cli "$@"\n')
    command.chmod(0o755)


def shell(line, folder, **environment):
    """Run a line, or several, in bash in a folder that has a command."""
    path = f"{folder / 'bin'}:{os.environ['PATH']}"
    return subprocess.run(
        ["bash", "-euo", "pipefail", "-c", line],
        cwd=folder,
        env={**os.environ, "PATH": path, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
