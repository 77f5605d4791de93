"""``volatool doctor``."""

from __future__ import annotations

import click


@click.command(short_help="Print versions, backends, caches and limits.")
@click.option("--warm", is_flag=True, help="Compile all kernels into the cache now.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object.")
def doctor(warm: bool, as_json: bool) -> None:
    """Print what this installation has: versions, LAZ backend, CRS database, kernel cache, memory.

    \b
    Examples:
      volatool doctor
      volatool doctor --warm
    """
    from volatool.doctor import diagnose, warm_kernels
    from volatool.report import dumps

    if warm:
        warm_kernels()
    document = diagnose()
    if as_json:
        click.echo(dumps(document))
        return
    width = max(map(len, document))
    for name, value in document.items():
        click.echo(f"{name.ljust(width)}  {value}")
