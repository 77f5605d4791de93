"""Checks of the documentation: generated pages, links, error codes. ``--write`` regenerates."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import click

DOCS = Path(__file__).resolve().parent
TOP = DOCS.parent

_LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]+)(?:#[^)]*)?\)")
_CODE = re.compile(r"\"([EW]_[A-Z][A-Z0-9_]+)\"")


def command_reference() -> str:
    """Return ``docs/reference/commands.md`` as the commands' own help says it."""
    from volatool_cli.main import cli

    parts = [
        "# Commands",
        "Written by `python docs/check.py --write` from the commands' own `--help`.",
        _help(cli, "volatool", None),
    ]
    context = click.Context(cli, info_name="volatool")
    for name in cli.list_commands(context):
        command = cli.get_command(context, name)
        assert command is not None
        parts.append(_help(command, name, context))
        if isinstance(command, click.Group):
            inner = click.Context(command, info_name=name, parent=context)
            parts += [
                _help(below, f"{name} {key}", context, inner)
                for key, below in sorted(command.commands.items())
            ]
    return "\n\n".join(parts) + "\n"


def _help(
    command: click.Command,
    name: str,
    parent: click.Context | None,
    group: click.Context | None = None,
) -> str:
    context = click.Context(
        command,
        info_name=name.split()[-1],
        parent=group or parent,
        terminal_width=100,
        max_content_width=100,
        help_option_names=["-h", "--help"],
    )
    title = name if parent is None else f"volatool {name}"
    return f"## {title}\n\n```text\n{command.get_help(context)}\n```"


def broken_links() -> list[str]:
    """Return the links of all Markdown files that point to no file."""
    faults = []
    pages = [*TOP.glob("*.md"), *DOCS.rglob("*.md"), *(TOP / "data_samples").glob("*.md")]
    for page in [*pages, *(TOP / "benchmarks").glob("*.md")]:
        for target in _LINK.findall(page.read_text(encoding="utf-8")):
            if "://" not in target and not (page.parent / target).exists():
                faults.append(f"{page.relative_to(TOP)}: no such file: {target}")
    return faults


def undocumented_codes() -> list[str]:
    """Return the error and warning codes of the source that the reference does not list."""
    source = "\n".join(path.read_text(encoding="utf-8") for path in (TOP / "src").rglob("*.py"))
    listed = (DOCS / "reference" / "codes.md").read_text(encoding="utf-8")
    found = sorted(set(_CODE.findall(source)))
    faults = [f"{code} is not in docs/reference/codes.md" for code in found if code not in listed]
    gone = sorted(set(re.findall(r"`([EW]_[A-Z0-9_]+)`", listed)) - set(found))
    return faults + [f"docs/reference/codes.md lists {code}, which is nowhere" for code in gone]


def main() -> int:
    """Check everything; return the exit status."""
    page = DOCS / "reference" / "commands.md"
    text = command_reference()
    if "--write" in sys.argv[1:]:
        page.write_text(text, encoding="utf-8")
    faults = broken_links() + undocumented_codes()
    if not page.exists() or page.read_text(encoding="utf-8") != text:
        faults.append("docs/reference/commands.md is old: python docs/check.py --write")
    for fault in faults:
        print(fault, file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
