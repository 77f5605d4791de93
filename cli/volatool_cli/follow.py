"""The loop over scans of ``volatool emap``: lines out as scans come in, and a clean end."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import click

from volatool.errors import InputError, OptionError, VolatoolError
from volatool.follow import Follower, FollowOptions, layer_path
from volatool.outputs import refuse_existing
from volatool.points.frames import FRAME_SUFFIXES, Frame, frames_of_files, frames_of_npy
from volatool_cli.exit_codes import ExitCode
from volatool_cli.interrupt import Interruptible
from volatool_cli.output import configure_logging


def follow(arguments: dict[str, Any]) -> None:
    """
    Run the command and exit with the status that says how it went.

    Parameters
    ----------
    arguments : dict
        The command's options by parameter name.
    """
    quiet = arguments.pop("quiet")
    configure_logging(quiet, arguments.pop("verbose"), arguments.pop("log"))
    inputs, form = arguments.pop("inputs"), arguments.pop("form")
    fail_fast, overwrite = arguments.pop("fail_fast"), arguments.pop("overwrite")
    no_resources, poses_name = arguments.pop("no_resources"), arguments.pop("poses")
    output, snapshot = _path(arguments.pop("output")), _path(arguments.pop("snapshot"))
    every = arguments.pop("every")
    if arguments["window"] == "all":
        arguments["window"] = None
    settings = FollowOptions(**arguments)
    shots = _Snapshots(snapshot, every, overwrite)
    for path in (output, shots.file):
        if path is not None:
            targets = [path, *(layer_path(path, layer) for layer in settings.layers)]
            refuse_existing(targets, overwrite)
    if output is not None and output == shots.file:
        raise OptionError("--output and --snapshot name the same file")
    frames = _frames(inputs, form)
    poses = None
    if poses_name is not None:
        from volatool.points.poses import read_poses

        poses = read_poses(Path(poses_name))
    follower = Follower(settings, poses)
    codes: list[str] = []
    ending: BaseException | None = None
    with Interruptible() as interruptible:
        try:
            _loop(follower, frames, interruptible, shots, codes, fail_fast, no_resources)
        except KeyboardInterrupt:
            ending = click.Abort()
        except BrokenPipeError as error:
            ending = error
        except VolatoolError as error:  # the map is whole: what it knows is still written
            ending = error
    if output is not None and not follower.write(output, overwrite) and not quiet:
        click.echo("W_EMPTY: no scan had a point to use; no model is written", err=True)
    if ending is not None:
        raise ending
    if codes:
        all_failed = len(codes) == follower.n_frames
        sys.exit(ExitCode.ALL_FAILED if all_failed else ExitCode.SOME_FAILED)


def _loop(
    follower: Follower,
    frames: Iterator[Frame],
    interruptible: Interruptible,
    shots: _Snapshots,
    codes: list[str],
    fail_fast: bool,
    no_resources: bool,
) -> None:
    from volatool.report import dumps

    while True:
        with interruptible.waiting():
            try:
                frame = next(frames, None)
            except InputError as error:  # nothing after it in the pipe can be found
                follower.n_frames += 1
                _say(error, codes)
                return
        if frame is None:
            return
        try:
            record = follower.take(frame)
        except InputError as error:
            _say(error, codes)
            if fail_fast:
                return
            continue
        if no_resources:
            del record["resources"]
        is_due = shots.is_due(follower.n_frames)
        record["snapshot"] = shots.write(follower) if is_due else None
        click.echo(dumps(record))
        sys.stdout.flush()


def _say(error: VolatoolError, codes: list[str]) -> None:
    click.echo(f"{error.code}: {error}", err=True)
    codes.append(error.code)


class _Snapshots:
    """Where models go while scans come, and when."""

    def __init__(self, target: Path | None, every: int, overwrite: bool) -> None:
        self.every = every
        self.overwrite = overwrite
        is_file = target is not None and target.suffix.lower() in (".tif", ".tiff")
        self.file = target if is_file else None
        self.folder = None if is_file else target

    def is_due(self, n_frames: int) -> bool:
        """Whether the scan just taken is one to write a model after."""
        is_wanted = self.file is not None or self.folder is not None
        return is_wanted and n_frames % self.every == 0

    def write(self, follower: Follower) -> str | None:
        """Write a model; return its name, None when there is nothing to write."""
        if self.file is not None:
            paths = follower.write(self.file, overwrite=True)  # its own of before
        else:
            assert self.folder is not None
            name = self.folder / f"emap-{follower.n_frames - 1:06d}.tif"
            paths = follower.write(name, self.overwrite)
        return str(paths[0]) if paths else None


def _path(name: str | None) -> Path | None:
    if name == "":
        raise OptionError("an output is an empty name; is a shell variable unset?")
    return None if name is None else Path(name)


def _frames(inputs: Sequence[str], form: str) -> Iterator[Frame]:
    if form == "npy":
        if [name for name in inputs if name != "-"]:
            raise OptionError("--format npy reads stdin, no names: leave them out")
        return frames_of_npy(_stdin())
    if not inputs:
        raise OptionError("no input: name scans, - for names on stdin, or give --format npy")
    return frames_of_files(_names(inputs))


def _names(inputs: Sequence[str]) -> Iterator[Path]:
    """Yield the names; those on stdin as they come."""
    from volatool.batch.plan import expand

    for argument in inputs:
        if argument != "-":
            yield from expand([argument], (), FRAME_SUFFIXES)
            continue
        for line in iter(_stdin().readline, b""):
            name = line.rstrip(b"\r\n")
            if name:
                yield Path(name.decode(sys.getfilesystemencoding(), "surrogateescape"))


def _stdin() -> BinaryIO:
    if sys.stdin is None:
        raise OptionError("stdin is closed, there is nothing to read")
    return sys.stdin.buffer
