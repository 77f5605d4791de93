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
    from volatool.doctor import diagnose
    from volatool.report import dumps

    if warm:
        from volatool.warming import PARTS, warm_kernels

        for part in PARTS:
            for done in warm_kernels([part]):
                click.echo(
                    f"{done.part}: {done.n_compiled} kernels compiled in {done.seconds:.1f} s",
                    err=True,
                )
    document = diagnose()
    if as_json:
        click.echo(dumps(document))
        return
    width = max(map(len, document))
    for name, value in document.items():
        click.echo(f"{name.ljust(width)}  {value}")
