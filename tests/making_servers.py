"""Real servers on loopback for tests: HTTP with or without ranges, and S3."""

from __future__ import annotations

import contextlib
import re
import threading
import time
from collections import Counter
from email.utils import formatdate
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote, urlsplit


class WebServer:
    """
    Files over HTTP on a port of its own; what it served is counted.

    Parameters
    ----------
    folder : pathlib.Path
        What is served; folders give a page with links.
    ranges : bool
        Answer requests for ranges with ranges.
    delay : float
        Seconds that each answer takes.
    says_so : bool
        Answers tell whether there are ranges.

    Attributes
    ----------
    requests : list of (str, str, int, int)
        Method, path, first byte and bytes of the body of each answer.
    failures : list of int
        Statuses to answer the next requests for bodies with; 0 hangs up half-way, None answers.
    users : list of str or None
        Values of the Authorization header that are let in; None for anyone.
    """

    def __init__(self, folder, ranges=True, delay=0.0, says_so=True):
        self.folder, self.ranges, self.delay, self.says_so = folder, ranges, delay, says_so
        self.requests, self.failures = [], []
        self.users = None
        self.statuses = Counter()
        server = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_HEAD(self):
                server.answer(self, with_body=False)

            def do_GET(self):
                server.answer(self, with_body=True)

            def log_message(self, *_):
                pass

        self._http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._http.daemon_threads = True
        self._thread = threading.Thread(target=self._http.serve_forever, args=(0.02,), daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._http.shutdown()
        self._http.server_close()

    @property
    def host(self):
        return f"127.0.0.1:{self._http.server_port}"

    def url(self, name=""):
        return f"http://{self.host}/{name}"

    @property
    def n_bytes(self):
        return sum(n for _, _, _, n in self.requests)

    def answer(self, handler, with_body):
        time.sleep(self.delay)
        name = unquote(urlsplit(handler.path).path).lstrip("/")
        status = self.failures.pop(0) if self.failures and with_body else None
        if self.users is not None and handler.headers.get("Authorization") not in self.users:
            status = 401
        if status:
            self._reply(handler, status, b"<html>no</html>", {"Content-Type": "text/html"})
            return
        path = self.folder / name
        if path.is_dir():
            links = "".join(f'<a href="{entry.name}">x</a>' for entry in sorted(path.iterdir()))
            page = f"<html>{links}</html>".encode()
            self._reply(handler, 200, page if with_body else b"", {"Content-Type": "text/html"})
            return
        if not path.is_file():
            self._reply(handler, 404, b"", {})
            return
        size, start = path.stat().st_size, 0
        stop, code, headers = size, 200, {"ETag": f'"{path.stat().st_mtime_ns}"'}
        headers["Last-Modified"] = formatdate(path.stat().st_mtime, usegmt=True)
        asked = re.fullmatch(r"bytes=(\d+)-(\d*)", handler.headers.get("Range", ""))
        if self.ranges and asked:
            start, stop = int(asked[1]), min(size, int(asked[2] or size - 1) + 1)
            code = 206
            headers["Content-Range"] = f"bytes {start}-{stop - 1}/{size}"
        elif self.says_so:
            headers["Accept-Ranges"] = "bytes" if self.ranges else "none"
        with path.open("rb") as file:
            file.seek(start)
            body = file.read(stop - start) if with_body else b""
        self.requests.append((handler.command, name, start, len(body)))
        self._reply(handler, code, body, headers, stop - start, hang_up=status == 0)

    def _reply(self, handler, status, body, headers, length=None, hang_up=False):
        self.statuses[status] += 1
        with contextlib.suppress(ConnectionError):  # it had enough
            handler.send_response(status)
            for key, value in headers.items():
                handler.send_header(key, value)
            handler.send_header("Content-Length", str(len(body) if length is None else length))
            handler.end_headers()
            if hang_up:
                handler.wfile.write(body[: len(body) // 2])
                handler.close_connection = True
                return
            handler.wfile.write(body)
