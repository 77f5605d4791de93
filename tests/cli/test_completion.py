"""Completion, by the shells themselves: a terminal, a line, the tabulator key."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import shutil
import subprocess
import sys
import termios
import time

import pytest

SHELLS = {
    "bash": ["bash", "--norc", "--noprofile", "-i"],
    "zsh": ["zsh", "-f", "-i"],
    "fish": ["fish", "--no-config", "-i"],
}
SETUP = {
    "bash": 'eval "$(volatool --completion bash)"',
    "zsh": 'autoload -Uz compinit; compinit -u; eval "$(volatool --completion zsh)"',
    "fish": "volatool --completion fish | source",
}


class Terminal:
    """A shell in a terminal of its own."""

    def __init__(self, shell, folder):
        self.shell, self.folder = shell, folder
        command = folder / "bin" / "volatool"
        command.parent.mkdir()
        command.write_text(
            f"""#!/bin/sh
            if [ $# -eq 0 ] || [ "$1" = --completion ]; then
                exec {sys.executable} -c 'from volatool_cli.main import main; main()' "$@"
            fi
            printf "%s\\n" "$@" >new && mv new arguments  # what the line came to
            """
        )
        command.chmod(0o755)
        self.master, slave = pty.openpty()
        self.process = subprocess.Popen(
            SHELLS[shell],
            cwd=folder,
            env={
                **os.environ,
                "PATH": f"{command.parent}:{os.environ['PATH']}",
                "TERM": "xterm",
                "HOME": str(folder),
                "XDG_DATA_HOME": str(folder / "data"),
                "XDG_CONFIG_HOME": str(folder / "config"),
            },
            stdin=slave,
            stdout=slave,
            stderr=slave,
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # fish wants a terminal
        )
        os.close(slave)
        self.shown = ""
        self.type(f"{SETUP[shell]}; echo rea''dy\r")
        self.wait_for(lambda: "ready" in self.shown)

    def type(self, keys):
        os.write(self.master, keys.encode())

    def wait_for(self, is_so, seconds=60):
        deadline = time.monotonic() + seconds
        while not is_so():
            assert time.monotonic() < deadline, self.shown
            if select.select([self.master], [], [], 0.05)[0]:
                text = os.read(self.master, 65536).decode(errors="replace")
                self.shown += text
                if "\x1b[c" in text or "\x1b[0c" in text:  # fish asks which terminal this is
                    self.type("\x1b[?62;c")

    def completed(self, line):
        """Return the arguments of the command that a line becomes by the tabulator key."""
        arguments = self.folder / "arguments"
        arguments.unlink(missing_ok=True)
        self.type(f"{line}\t\r")
        self.wait_for(arguments.exists)
        return arguments.read_text().split("\n")[:-1]

    def close(self):
        self.process.kill()
        self.process.wait()
        os.close(self.master)


@pytest.fixture(params=SHELLS)
def terminal(request, tmp_path):
    if shutil.which(request.param) is None:
        pytest.skip(f"{request.param} is not installed")
    (tmp_path / "north tile.laz").touch()
    (tmp_path / "tiles").mkdir()
    (tmp_path / "tiles" / "south.laz").touch()
    terminal = Terminal(request.param, tmp_path)
    yield terminal
    terminal.close()


def test_the_tabulator_key_completes_commands_options_choices_and_file_names(terminal):
    for line, expected in {
        "volatool conv": ["convert"],
        "volatool convert --surf": ["convert", "--surface"],
        "volatool stats --format jsonl --summ": ["stats", "--format", "jsonl", "--summary"],
        "volatool convert --surface ds": ["convert", "--surface", "dsm"],
        "volatool convert --layers count,dist": ["convert", "--layers", "count,distance"],
        "volatool convert nor": ["convert", "north tile.laz"],
        "volatool info tiles/so": ["info", "tiles/south.laz"],
        "volatool dem tile.laz --water nor": ["dem", "tile.laz", "--water", "north tile.laz"],
        "volatool query tile.vol.gz comp": ["query", "tile.vol.gz", "components"],
    }.items():
        if terminal.shell == "fish" and "," in line:
            continue  # click's script for it takes what follows a comma for something else
        assert terminal.completed(line) == expected, line


@pytest.mark.parametrize("shell", SHELLS)
def test_the_script_is_one_that_the_shell_can_read(shell, volatool):
    done = volatool("--completion", shell)
    assert done.returncode == 0
    assert "_VOLATOOL_COMPLETE" in done.stdout
    if shutil.which(shell):
        read = subprocess.run([shell, "-n"], input=done.stdout, text=True, capture_output=True)
        assert (read.returncode, read.stderr) == (0, "")


def test_a_shell_without_a_script_is_a_usage_error(volatool):
    done = volatool("--completion", "cmd.exe")
    assert done.returncode == 2
    assert done.stderr.startswith("E_OPTION: Invalid value for '--completion'")
