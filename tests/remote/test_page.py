"""The how-to on object storage: its commands run, against servers on loopback."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

TOP = Path(__file__).resolve().parents[2]


def test_the_commands_of_the_page_run(s3, web, tmp_path):
    (web.folder / "tiles").mkdir()
    sample = TOP / "data_samples" / "forest.laz"
    for name in ("forest.laz", "forest.copc.laz"):
        shutil.copy(sample, web.folder / "tiles" / name)
    s3.mkdir("bucket")
    s3.put_file(str(sample), "bucket/tiles/forest.laz")
    s3.pipe_file("bucket/tiles.txt", b"s3://bucket/tiles/forest.laz\n")
    text = (TOP / "docs/how-to/cloud.md").read_text(encoding="utf-8")
    lines = "".join(re.findall(r"^```sh\n(.*?)^```$", text, re.MULTILINE | re.DOTALL))
    assert lines.count("volatool") > 8
    for line in lines.splitlines():
        line = line.replace("https://example.org/", web.url())
        line = line.replace("volatool convert", "volatool convert --overwrite")
        command = line.replace("volatool", f"'{sys.executable}' -m volatool_cli", 1)
        done = subprocess.run(
            ["bash", "-euc", command], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{line}\n{done.stderr}"
    s3.rm("bucket", recursive=True)
