"""The one place that configures numba: how kernels compile and where they are cached.

Kernels compile on their first call, never at import, release the GIL and are kept in an on-disk
cache of volatool's own. numba numbers its cache files by reading the index, writing the code and
then the index again; two processes doing so at once can overwrite each other's code under one
name (numba issues 4807 and 10128). Every such read-modify-write is done under a file lock that
readers share. A second lock lets one process compile at a time (`_Turn`).

A process that finds all its kernels in the cache never compiles, so that it needs nothing of what
numba registers for its compiler: a load does without the refresh of numba's registries, which
costs 20 ms a kernel and imports SciPy (`_SharedCache`), and without the code that other kernels
would be compiled with, half of what is left (`_Library`).
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import logging
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TextIO

import numba
import numpy as np
from llvmlite import binding
from numba.core import caching, codegen, event
from numba.core.runtime.nrt import rtsys

from volatool._version import __version__

logger = logging.getLogger(__name__)

MAX_TURN_S = 120.0
"""How long a process waits for another one's compilation, in seconds."""

_POLL_S = 0.02


def cache_dir() -> Path:
    """
    Folder that holds the compiled kernels of this version on this machine.

    ``VOLATOOL_CACHE_DIR`` if set, else ``volatool`` in the user's cache folder; below it one
    folder per version of volatool, numba, numpy and Python, and per CPU.

    Returns
    -------
    path : pathlib.Path
        The folder; it need not exist yet.
    """
    root = os.environ.get("VOLATOOL_CACHE_DIR")
    if not root:
        base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
        root = str(Path(base) / "volatool")
    features = binding.get_host_cpu_features().flatten()
    cpu = hashlib.sha256(f"{binding.get_host_cpu_name()} {features}".encode()).hexdigest()[:12]
    # the code's place is part of numba's own key; two installations may share the folder
    key = (
        f"{__version__}-numba{numba.__version__}-numpy{np.__version__}"
        f"-py{sys.version_info.major}{sys.version_info.minor}-{platform.machine()}-{cpu}"
    )
    return Path(root) / "kernels" / key


@functools.cache
def writable_cache_dir() -> Path | None:
    """
    Return the cache folder, made if need be, or None when it can't be written.

    Returns
    -------
    path : pathlib.Path or None
        None means: compile in memory, once per process.
    """
    try:
        path = cache_dir()
        path.mkdir(parents=True, exist_ok=True)
        probe = path / f".probe-{os.getpid()}"
        probe.touch()
        probe.unlink()
    except (OSError, RuntimeError):  # RuntimeError: no home folder
        return None
    return path


@contextlib.contextmanager
def _locked(folder: Path, *, shared: bool) -> Iterator[None]:
    """Hold the cache folder's lock; without fcntl (Windows) numba's own atomic renames must do."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    with (folder / ".lock").open("a") as file:
        fcntl.flock(file, fcntl.LOCK_SH if shared else fcntl.LOCK_EX)
        yield


class _Turn:
    """
    The right to compile, of one process at a time: the others wait, and find what it saved.

    Ten processes that start on an empty cache then compile each kernel once, not ten times. A
    kernel's compilation may begin those of the kernels it calls, so that a turn has a depth.
    """

    def __init__(self) -> None:
        self._depth = 0
        self._file: TextIO | None = None

    def take(self, folder: Path) -> None:
        """Wait for the turn, but not for ever: without it a kernel is compiled twice, no more."""
        self._depth += 1
        if self._depth > 1:
            return
        with contextlib.suppress(ImportError, OSError):
            import fcntl

            self._file = (folder / ".turn").open("a")
            waited_s = 0.0
            while waited_s < MAX_TURN_S:
                with contextlib.suppress(BlockingIOError):
                    fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    return
                time.sleep(_POLL_S)
                waited_s += _POLL_S

    def give(self) -> None:
        """Let the next process compile."""
        self._depth -= 1
        if self._depth == 0 and self._file is not None:
            self._file.close()
            self._file = None


_turn = _Turn()


class _Failures(event.Listener):
    """Gives the turn away when a compilation fails (or is interrupted) and so saves nothing."""

    def on_start(self, event: Any) -> None:
        pass

    def on_end(self, event: Any) -> None:
        # not is_failed, which numba 0.61 to 0.68 has the wrong way round
        failed = getattr(event, "_exc_details", None) is not None
        if failed and isinstance(event.data["dispatcher"]._cache, _SharedCache):
            _turn.give()


class _Library(codegen.JITCodeLibrary):
    """
    A kernel from the cache whose bitcode is parsed when another kernel is compiled with it.

    To run it, its machine code is enough.
    """

    _machine_code = b""
    _bitcode: bytes | None = None

    @classmethod
    def _unserialize(cls, codegen: Any, state: Any) -> Any:
        name, kind, data = state
        if kind != "object":
            return super()._unserialize(codegen, state)
        library = codegen.create_library(name)
        library._machine_code, library._bitcode = data
        library.enable_object_caching()
        library._set_compiled_object(library._machine_code)
        library._finalize_final_module()
        return library

    def get_pointer_to_function(self, name: str) -> Any:
        if name.encode() in self._machine_code:  # among its symbols
            return self._codegen._engine.get_function_address(name)
        self._parse()
        return super().get_pointer_to_function(name)

    def _get_module_for_linking(self) -> Any:
        self._parse()
        return super()._get_module_for_linking()

    def _parse(self) -> None:
        if self._bitcode is not None:
            self._shared_module = binding.parse_bitcode(self._bitcode)
            self._bitcode = None
            self._codegen._engine._load_defined_symbols(self._shared_module)


class _Loading(caching.CompileResultCacheImpl):
    """Makes kernels from what is in the cache, in numba's own way if ours fails."""

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        maker = target_context.codegen()
        with contextlib.suppress(Exception):
            before, maker._library_class = maker._library_class, _Library
            try:
                made = super().rebuild(target_context, payload)
            finally:
                maker._library_class = before
            made.library._machine_code = b""  # the engine has it now
            return made
        return super().rebuild(target_context, payload)


class _SharedCache(caching.FunctionCache):
    """numba's function cache, shared by processes that start together."""

    _impl_class = _Loading
    _is_damaged = False

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        folder = writable_cache_dir()
        if folder is None:
            return None
        found = self._read(folder, sig, target_context)
        if found is not None:
            return found
        _turn.take(folder)
        found = self._read(folder, sig, target_context)  # another process may have saved it
        if found is not None:
            _turn.give()
        return found

    def _read(self, folder: Path, sig: Any, target_context: Any) -> Any:
        with _locked(folder, shared=True):
            if not hasattr(self, "_load_overload"):  # another numba than the ones known
                return super().load_overload(sig, target_context)
            # what compiled code refers to; the rest of a refresh is done before a compilation,
            # by the compiler itself
            rtsys.initialize(target_context)
            try:
                return self._load_overload(sig, target_context)
            except Exception as error:  # a file cut short or damaged: pickle raises what it will
                logger.info("%s: compiled again (%s)", self.cache_path, error)
                self._is_damaged = True
                return None

    def save_overload(self, sig: Any, data: Any) -> None:
        folder = writable_cache_dir()
        if folder is None:
            return
        try:
            # a full disk: not cached
            with _locked(folder, shared=False), contextlib.suppress(OSError):
                if self._is_damaged:
                    self.flush()
                    self._is_damaged = False
                super().save_overload(sig, data)
        finally:
            _turn.give()


event.register("numba:compile", _Failures())


def kernel(function: Callable[..., Any]) -> Any:
    """
    Compile a function with numba when it is first called, releasing the GIL, cached on disk.

    Parameters
    ----------
    function : callable
        Arrays and scalars in and out. Other kernels may be called from it.

    Returns
    -------
    kernel : callable
        The dispatcher; ``kernel.py_func`` is the plain Python function.

    Notes
    -----
    ``fastmath`` is off: results must not depend on the CPU's vector width.
    """
    dispatcher: Any = numba.njit(nogil=True, error_model="numpy")(function)
    folder = writable_cache_dir()
    if folder is not None:
        # numba takes the folder from its configuration only; put back what other packages see
        config: Any = numba.config
        before, config.CACHE_DIR = config.CACHE_DIR, str(folder)
        try:
            dispatcher._cache = _SharedCache(function)
        finally:
            config.CACHE_DIR = before
    return dispatcher
