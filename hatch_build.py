"""Build hook: the manual pages, made from the commands' help, become part of the wheel."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class ManualPages(BuildHookInterface[Any]):
    """Put ``share/man/man1`` into the wheel."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Write the pages; an editable install has them too, as they were on that day."""
        del version
        top = Path(self.root)
        sys.path[:0] = [str(top / folder) for folder in ("docs", "src", "cli")]
        from man import write_pages

        self._folder = tempfile.TemporaryDirectory()
        for page in write_pages(Path(self._folder.name)):
            build_data["shared_data"][str(page)] = f"share/man/man1/{page.name}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the temporary folder."""
        del version, build_data, artifact_path
        self._folder.cleanup()
