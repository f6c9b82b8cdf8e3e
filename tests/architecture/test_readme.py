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

from vascval.cli.main import cli

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
    assert 'pip install ".[test]" && pytest' in LINES


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


def test_quick_commands_run(tmp_path):
    assert QUICK, "no console block of README.md is marked <!-- quick -->"
    scripts = Path(sys.executable).parent
    environment = {**os.environ, "PATH": f"{scripts}{os.pathsep}{os.environ['PATH']}"}
    for line in QUICK:
        done = subprocess.run(
            line, shell=True, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"$ {line}\n{done.stdout}{done.stderr}"
    program = re.search(r"```python\n(.*?)```", TEXT, re.DOTALL)
    assert program, "README.md shows no Python"
    done = subprocess.run(
        [sys.executable, "-c", program[1]], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
