"""Runs commands on a small disk of its own: ``unshare -rm python faults_driver.py FOLDER``, cases as JSON on stdin.

Each case is ``{"size_kb", "read_only", "old": {name: text}, "arguments"}``. A file system of that size is laid over
FOLDER/disk, the old files are put there, the command runs in it and what came of it is printed: its exit code, what it
said on stderr, and the files there are now with their text or, if they are not text, their size.
"""

import contextlib
import io
import json
import subprocess
import sys
from pathlib import Path

from vascval.cli.main import main


def listed(folder):
    files = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            content = path.read_bytes()
            small = len(content) < 100 and content.isascii()
            files[str(path.relative_to(folder))] = content.decode() if small else len(content)
    return files


def outcome(case, disk):
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={case['size_kb']}k", "none", str(disk)], check=True)
    try:
        for name, text in case["old"].items():
            (disk / name).parent.mkdir(exist_ok=True)
            (disk / name).write_text(text)
        if case["read_only"]:
            subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main(case["arguments"])
        return {"code": code, "err": err.getvalue(), "files": listed(disk)}
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)


if __name__ == "__main__":  # workers of an ensemble import this module
    disk = Path(sys.argv[1]) / "disk"
    disk.mkdir()
    json.dump([outcome(case, disk) for case in json.load(sys.stdin)], sys.stdout)
