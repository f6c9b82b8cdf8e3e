"""What README.md tells a reader to type works.

Its ``console`` blocks hold the lines typed, each after ``$ ``. All lines that begin with ``vascval`` are checked for
the names of commands and options; blocks below a line ``<!-- quick -->`` are run, in order, in one directory, and then
the Python program.
"""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import click
import pytest

from vascval.cli.main import cli, main

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"(?P<quick><!-- quick -->\s*\n)?```console\n(?P<body>.*?)```", re.DOTALL)


def typed(body: str) -> list[str]:
    """The lines typed in a block; a backslash at the end carries on."""
    return re.findall(r"^\$ (.*)$", body.replace("\\\n", " "), re.MULTILINE)


LINES = [line for block in BLOCK.finditer(TEXT) for line in typed(block["body"])]
QUICK = [line for block in BLOCK.finditer(TEXT) if block["quick"] for line in typed(block["body"])]


def test_set_up_takes_two_commands():
    assert "pip install . && vascval demo" in LINES
    assert 'pip install ".[test]" && pytest -n 2' in LINES


@pytest.mark.parametrize("line", LINES)
def test_commands_and_options_exist(line):
    for part in re.split(r"&&|\|\||;|\|", line):
        words = shlex.split(part, comments=True)
        if len(words) < 2 or words[0] != "vascval" or words[1].startswith("-"):
            continue
        command = cli.get_command(click.Context(cli), words[1])
        assert command is not None, f"README names a command that does not exist: {words[1]}"
        known = {name for parameter in command.params for name in parameter.opts} | {"--help"}
        options = {word.split("=")[0] for word in words[2:] if re.match(r"--?[a-z]", word)}
        assert options <= known


def test_quick_commands_run(tmp_path, monkeypatch):
    """The first by the shell, as it is typed; the others in this process, which has its libraries loaded."""
    assert QUICK, "no console block of README.md is marked <!-- quick -->"
    monkeypatch.chdir(tmp_path)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    subprocess.run(QUICK[0], shell=True, env={**os.environ, "PATH": path}, check=True)
    for line in QUICK[1:]:
        program, *arguments = shlex.split(line)
        assert program == "vascval", f"what runs is another program: {line}"
        assert main(arguments) == 0, f"$ {line}"
    program = re.search(r"```python\n(.*?)```", TEXT, re.DOTALL)
    assert program, "README.md shows no Python"
    exec(program[1], {})
