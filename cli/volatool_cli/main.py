"""The ``volatool`` command: its subcommands, and errors and signals turned into exit statuses."""

from __future__ import annotations

import logging
import os
import sys
from pathlib import Path
from typing import Any, NoReturn

import click
from click.shell_completion import get_completion_class

from volatool import __version__
from volatool.errors import VolatoolError
from volatool_cli.commands.check import check
from volatool_cli.commands.classify import classify
from volatool_cli.commands.convert import convert
from volatool_cli.commands.dem import dem
from volatool_cli.commands.diff import diff
from volatool_cli.commands.doctor import doctor
from volatool_cli.commands.emap import emap
from volatool_cli.commands.export import export
from volatool_cli.commands.import_ import import_
from volatool_cli.commands.index import index
from volatool_cli.commands.info import info
from volatool_cli.commands.merge import merge
from volatool_cli.commands.query import query
from volatool_cli.commands.query_space import SPACE_KINDS
from volatool_cli.commands.recommend import recommend
from volatool_cli.commands.reproduce import reproduce
from volatool_cli.commands.retile import retile
from volatool_cli.commands.stats import stats
from volatool_cli.commands.validate import validate
from volatool_cli.exit_codes import ExitCode, code_for

logger = logging.getLogger("volatool")


class CodedError(click.ClickException):
    """A volatool error as click shows it: one line on stderr, its exit status."""

    def __init__(self, error: VolatoolError) -> None:
        super().__init__(f"{error.code}: {error}")
        self.exit_code = code_for(error)  # type: ignore[misc]

    def show(self, file: Any = None) -> None:
        """Print the one line."""
        click.echo(self.format_message(), file=file, err=True)


class VolatoolGroup(click.Group):
    """A group whose commands may raise volatool's errors."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command."""
        try:
            return super().invoke(ctx)
        except VolatoolError as error:
            logger.info("%s", error, exc_info=True)
            raise CodedError(error) from error
        except BrokenPipeError:
            _close_stdout()
            raise click.exceptions.Exit(ExitCode.STDOUT_CLOSED) from None


def _print_completion(ctx: click.Context, param: click.Parameter, shell: str | None) -> None:
    """Print click's completion script for a shell and leave."""
    del param
    if shell is not None:
        completion = get_completion_class(shell)
        assert completion is not None
        name = "volatool"  # what the entry point is installed as, however this was started
        click.echo(completion(cli, {}, name, "_VOLATOOL_COMPLETE").source())
        ctx.exit()


@click.group(
    cls=VolatoolGroup,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    short_help="Turn LiDAR tiles into VOLA volumes, elevation models and statistics.",
    epilog="Documentation and error codes: docs/ in the source repository.",
)
@click.version_option(__version__, prog_name="volatool")
@click.option(
    "--completion",
    type=click.Choice(["bash", "zsh", "fish"]),
    is_eager=True,
    expose_value=False,
    callback=_print_completion,
    help="Print the script that completes commands, options and file names in a shell.",
)
@click.pass_context
def cli(ctx: click.Context) -> None:
    """Turn LAS, LAZ and COPC tiles into VOLA volumes, elevation models and statistics.

    \b
    Examples:
      volatool convert tile.laz
      volatool stats tiles/*.laz --summary
      volatool validate tile.vol.gz
    """
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help(), err=True)
        ctx.exit(ExitCode.USAGE)


for command in (
    convert,
    stats,
    info,
    dem,
    check,
    classify,
    emap,
    import_,
    export,
    query,
    diff,
    merge,
    index,
    recommend,
    retile,
    validate,
    reproduce,
    doctor,
):
    cli.add_command(command)
for command in SPACE_KINDS:
    query.add_command(command)


def main() -> NoReturn:
    """Run the command line and exit; the entry point."""
    logging.captureWarnings(True)  # of NumPy and others: no line of ours, and none that helps
    # rasterio loads boto3 (0.15 s) where it is installed; no raster of ours is read from S3 by GDAL
    sys.modules.setdefault("boto3", None)  # type: ignore[arg-type]
    if sys.stdout is None:  # it was closed from the start: what is printed goes nowhere
        sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115  for good
    try:
        status = cli.main(prog_name="volatool", standalone_mode=False)
        sys.stdout.flush()
    except click.exceptions.Abort:
        click.echo("interrupted", err=True)
        status = ExitCode.INTERRUPTED
    except click.UsageError as error:
        _show_usage(error)
        status = ExitCode.USAGE
    except click.ClickException as error:
        error.show()
        status = error.exit_code
    except BrokenPipeError:
        _close_stdout()
        status = ExitCode.STDOUT_CLOSED
    except OSError as error:
        click.echo(f"E_WRITE: output can't be written ({error.strerror or error})", err=True)
        logger.info("output failed", exc_info=True)
        status = ExitCode.NOT_WRITTEN
    except MemoryError:
        click.echo(
            "E_MEMORY: the machine has no memory left; lower --memory or close others", err=True
        )
        status = ExitCode.LIMIT
    except Exception as error:  # a bug: one line for the user, the traceback in the log
        logger.info("internal error", exc_info=True)
        click.echo(f"E_INTERNAL: {type(error).__name__}: {error} (-v shows where)", err=True)
        status = ExitCode.INTERNAL
    sys.exit(int(status) if isinstance(status, int) else 0)


def _close_stdout() -> None:
    """Keep the interpreter from flushing into a stdout whose reader has gone."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _show_usage(error: click.UsageError) -> None:
    """Print a usage error as one coded line."""
    path = "volatool" if error.ctx is None else error.ctx.command_path
    click.echo(f"E_OPTION: {error.format_message()} ({path} --help)", err=True)
