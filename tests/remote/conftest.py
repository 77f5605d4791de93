"""A web server and an S3 server on loopback."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from making_servers import WebServer


@pytest.fixture
def web(tmp_path):
    """A web server over a folder of its own; see `WebServer`."""
    folder = tmp_path / "served"
    folder.mkdir()
    with WebServer(folder) as server:
        yield server


@pytest.fixture(scope="session")
def s3_server():
    """Address of an S3 server, one for all tests of a process."""
    server = pytest.importorskip("moto.server").ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    yield f"http://{host}:{port}"
    server.stop()


@pytest.fixture
def s3(s3_server, monkeypatch):
    """A file system with an empty bucket ``tiles``; the environment leads to it."""
    import s3fs

    for name, value in {
        "AWS_ENDPOINT_URL": s3_server,
        "AWS_ACCESS_KEY_ID": "tester",
        "AWS_SECRET_ACCESS_KEY": "wontbetold",
        "AWS_DEFAULT_REGION": "us-east-1",
    }.items():
        monkeypatch.setenv(name, value)
    s3fs.S3FileSystem.clear_instance_cache()
    files = s3fs.S3FileSystem()
    files.mkdir("tiles")
    yield files
    files.invalidate_cache()
    files.rm("tiles", recursive=True)
    s3fs.S3FileSystem.clear_instance_cache()


@pytest.fixture
def volatool(tmp_path):
    """Run ``volatool`` as a process in a folder of its own."""

    def run(*arguments, **env):
        return subprocess.run(
            [sys.executable, "-m", "volatool_cli", *map(str, arguments)],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            env={**os.environ, **env},
            timeout=120,
            check=False,
        )

    return run
