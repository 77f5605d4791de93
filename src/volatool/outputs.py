"""Output files that appear whole or not at all: temporary name beside, fsync, rename."""

from __future__ import annotations

import contextlib
import errno
import os
import platform
import re
import weakref
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

from volatool.errors import OptionError, OutputError, OutputExistsError
from volatool.remote.path import RemotePath

_TEMPORARY = re.compile(
    r"\.(?P<name>.+)\.volatool-(?P<host>[A-Za-z0-9_]*)-(?P<pid>[0-9]+)\.tmp(\..+)?"
)
_LONGEST_STEM = 40  # of at most 4 bytes each: file systems take names of 255 bytes
_HOST = re.sub("[^A-Za-z0-9_]", "_", platform.node())
_swept: set[Path] = set()  # folders: looking through thousands of outputs before each takes long
_sets: weakref.WeakSet[OutputSet] = weakref.WeakSet()  # all of this process, for `discard_all`


class OutputSet:
    """
    The files of one run, renamed to their names together at the end.

    Parameters
    ----------
    overwrite : bool
        Whether outputs that exist may be replaced.

    Notes
    -----
    Used as a context manager: leaving it without `commit` removes what was written. A killed run
    leaves only hidden files ``.NAME.volatool-HOST-PID.tmp``, which the next process that writes
    into that folder on the same machine removes when none of that number is alive.
    """

    def __init__(self, overwrite: bool = False) -> None:
        self.overwrite = overwrite
        self._pending: dict[Path, Path] = {}
        _sets.add(self)

    def __enter__(self) -> OutputSet:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.discard()

    def discard(self) -> None:
        """Remove what was written and has no name yet; another thread may still be writing."""
        for temporary in list(self._pending.values()):
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
        self._pending.clear()  # none before it is gone: the process may end after this

    def add(self, target: Path) -> Path:
        """
        Return the temporary path to write an output to.

        Parameters
        ----------
        target : pathlib.Path
            The name it will have after `commit`.

        Returns
        -------
        temporary : pathlib.Path
            In the same folder, with the same last suffix (drivers look at it).

        Raises
        ------
        OutputExistsError
            If the target exists and must not be overwritten.
        OutputError
            If the folder can't be made or written.
        """
        refuse_existing([target], self.overwrite)
        folder = target.parent
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise write_error(folder, error) from error
        if folder not in _swept:
            sweep(folder)
            _swept.add(folder)
        # the number tells apart long names of which only the beginning fits
        stem = target.name[:_LONGEST_STEM] + f".{len(self._pending)}"
        name = f".{stem}.volatool-{_HOST[:24]}-{os.getpid()}.tmp{target.suffix}"
        temporary = folder / name
        self._pending[target] = temporary
        return temporary

    def commit(self, planned: Sequence[Path] = ()) -> list[Path]:
        """
        Make all outputs durable and give them their names.

        Parameters
        ----------
        planned : sequence of pathlib.Path
            Outputs that might have been written: those that were not are removed, so that none of
            an earlier run stays beside ones that contradict it. Only when overwriting.

        Returns
        -------
        paths : list of pathlib.Path
            In the order of `add`.

        Raises
        ------
        OutputError
            If one can't be written; those not renamed yet are removed.
        """
        folders = {target.parent for target in self._pending}
        try:
            for temporary in self._pending.values():
                _sync(temporary)
            paths = list(self._pending)
            for target in paths:
                self._pending[target].replace(target)
                del self._pending[target]
            for target in planned if self.overwrite else ():
                if target not in paths:
                    target.unlink(missing_ok=True)
            for folder in folders:
                _sync(folder)
        except OSError as error:
            raise write_error(error.filename or next(iter(folders)), error) from error
        return paths


def refuse_existing(targets: list[Path], overwrite: bool) -> None:
    """
    Raise if one of the outputs exists and must not be overwritten.

    Raises
    ------
    OutputExistsError
        Naming the first that exists.
    """
    remote = [target for target in targets if isinstance(target, RemotePath)]
    if remote:
        from volatool.remote.uploads import refuse_remote

        refuse_remote(remote, overwrite)
    for target in targets:
        if isinstance(target, RemotePath):
            continue
        try:
            is_folder, is_file = target.is_dir(), target.is_file()
            is_there = target.exists() or target.is_symlink()
        except (OSError, ValueError) as error:  # a name too long, or with a NUL
            raise OptionError(f"{target}: can't be the name of an output ({error})") from error
        if is_folder:
            raise OutputExistsError(f"{target}: is a folder, an output file was to be written")
        if is_there and not is_file and not target.is_symlink():
            raise OutputExistsError(
                f"{target}: is a device or a pipe, only files can be written; give another name"
            )
        if is_there and not overwrite:
            raise OutputExistsError(f"{target}: exists; give --overwrite to replace it")


def sweep(folder: Path) -> None:
    """Remove temporary files of this machine's runs that are no longer alive, if it is there."""
    if not folder.is_dir():
        return
    try:
        with os.scandir(folder) as entries:  # there may be a million outputs in it
            matches = [match for entry in entries if (match := _TEMPORARY.fullmatch(entry.name))]
    except OSError as error:
        raise write_error(folder, error) from error
    for match in matches:
        # the folder may be shared: of another machine's processes we know nothing
        if match["host"] == _HOST[:24] and not is_alive(int(match["pid"])):
            with contextlib.suppress(OSError):
                (folder / match.string).unlink()


def discard_all() -> None:
    """Remove what this process was writing, before it ends at once, from whatever thread."""
    for outputs in list(_sets):
        outputs.discard()


def write_error(path: object, error: OSError) -> OutputError:
    """Return the error for a file or folder that could not be written."""
    what_to_do = {
        errno.ENOSPC: "free space there or choose another folder",
        errno.EDQUOT: "free space there or choose another folder",
        errno.EACCES: "check its permissions or choose another folder",
        errno.EPERM: "check its permissions or choose another folder",
    }.get(error.errno or 0, "choose another folder")
    match = _TEMPORARY.fullmatch(Path(str(path)).name)
    if match:  # what the user knows is the name it would have had
        path = Path(str(path)).with_name(match["name"].rpartition(".")[0])
    return OutputError(f"{path}: can't be written ({error.strerror or error}); {what_to_do}")


def is_alive(pid: int) -> bool:
    """Whether a process of this number runs."""
    if pid == os.getpid():
        return True
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):  # no process has such a number
        return False
    except OSError:
        return True
    return True


def _sync(path: Path) -> None:
    """Flush a file, or the names in a folder, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # some file systems can't sync a folder
            raise
    finally:
        os.close(descriptor)
