"""The command line before any work begins: help, usage errors, exit codes, one line for every error."""

import errno
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import click
import pytest

from vascval import __version__
from vascval.cli import console
from vascval.cli.interruption import held_back
from vascval.cli.main import cli, main
from vascval.cli.options import Memory, Numbers, Threshold
from vascval.core.errors import ComputationError, InputError

COMMANDS = ["demo", "compare", "skeletonize", "analyze", "generate", "optimum", "twin", "ensemble", "view", "schema"]
VASCVAL = [sys.executable, "-m", "vascval.cli"]


def error_line(capsys) -> str:
    """The one line on stderr, nothing being on stdout."""
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("vascval: error: ")
    return err


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"vascval {__version__}\n"


def test_help_lists_every_command(capsys):
    assert main(["--help"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert [name for name in COMMANDS if re.search(rf"^  {name}  +\w", out, re.MULTILINE)] == COMMANDS


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_each_command(name, capsys):
    assert main([name, "--help"]) == 0
    out = capsys.readouterr().out
    assert f"vascval {name}" in out.splitlines()[0]
    assert "Examples:" in out
    assert "--quiet" in out and "--debug" in out


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_explained(name):
    command = cli.get_command(click.Context(cli), name)
    silent = [option.name for option in command.params if isinstance(option, click.Option) and not option.help]
    assert silent == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "Missing command; see 'vascval --help'"),
        (["thrive"], "No such command 'thrive'"),
        (["--loud"], "No such option"),
        (["analyze"], "Missing argument 'VOLUME_OR_TREE'; see 'vascval analyze --help'"),
        (["compare", "cast.nrrd"], "Missing argument 'TREE...'"),
        (["skeletonize", "cast.nrrd"], "Missing option '-o'"),
        (["analyze", "a", "b"], "unexpected extra argument"),
        (["analyze", "a", "--label", "one"], "Invalid value for '--label'"),
        (["analyze", "a", "--label", "1", "--threshold", "5"], "--label and --threshold exclude each other"),
        (["analyze", "a", "--root", "1,2"], "'1,2' is not three numbers joined by commas"),
        (["analyze", "a", "--root", "1,2,inf"], "'1,2,inf' is not three numbers"),
        (["analyze", "a", "--spacing", "1,0,1"], "'1,0,1' has a number that is not above 0"),
        (["analyze", "a", "--threshold", "high"], "'high' is neither a grey value nor 'auto'"),
        (["twin", "a", "-o", "b", "--hull-radius", "nan"], "'--hull-radius': 'nan' is not a finite number"),
        (["twin", "a", "-o", "b", "--hull-margin", "inf"], "'--hull-margin': 'inf' is not a finite number"),
        (["compare", "a", "b", "--tolerance", "nan"], "'--tolerance': 'nan' is not a finite number"),
        (["analyze", "a", "--threshold", "nan"], "'nan' is neither a grey value nor 'auto'"),
        (["analyze", "a", "--max-memory", "lots"], "'lots' is not a size such as 800MB or 2GB"),
        (["analyze", "a", "--unit", "inch"], "Invalid value for '--unit'"),
        (["view", "a.vtp", "--screenshot"], "Option '--screenshot' requires an argument"),
    ],
)
def test_usage_errors(arguments, message, capsys):
    assert main(arguments) == 2
    assert message in error_line(capsys)


@pytest.mark.parametrize(
    ("text", "numbers"), [("1,2,3", (1.0, 2.0, 3.0)), ("-1.5, 0,2e1", (-1.5, 0.0, 20.0)), ("0.5", (0.5, 0.5, 0.5))]
)
def test_numbers(text, numbers):
    assert Numbers(broadcast=True).convert(text, None, None) == numbers


@pytest.mark.parametrize(
    ("text", "size"),
    [("2GB", 2 * 10**9), ("800mb", 8 * 10**8), ("1.5GiB", 3 * 2**29), ("96", 96), ("1 k", 1000), ("2T", 2 * 10**12)],
)
def test_memory(text, size):
    assert Memory().convert(text, None, None) == size


@pytest.mark.parametrize("text", ["", "GB", "-1GB", "0", "1PB", "2 GB RAM", "nan"])
def test_memory_refused(text):
    with pytest.raises(click.BadParameter, match=r"is not a size|leaves no memory"):
        Memory().convert(text, None, None)


@pytest.mark.parametrize(("text", "value"), [("12.5", 12.5), ("auto", "auto"), ("OTSU", "auto"), ("-3", -3.0)])
def test_threshold(text, value):
    assert Threshold().convert(text, None, None) == value


def failing(monkeypatch, error: BaseException) -> int:
    """The exit code where ``vascval schema`` meets that error."""

    def names():
        raise error

    monkeypatch.setattr("vascval.io.schemas.names", names)
    return main(["schema"])


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (InputError("x.vtp: no tree; give another"), 2, "vascval: error: x.vtp: no tree; give another\n"),
        (InputError("two\nlines"), 2, "vascval: error: two\\nlines\n"),
        (ComputationError("did not converge"), 1, "vascval: error: did not converge\n"),
        (MemoryError("Unable to allocate 9 TiB"), 1, "vascval: error: not enough memory (Unable to allocate 9 TiB); "),
        (PermissionError(errno.EACCES, "Permission denied", "o.vtp"), 2, "vascval: error: o.vtp: Permission denied; "),
        (OSError(errno.ENOSPC, "No space left on device"), 1, "vascval: error: No space left on device; "),
        (KeyboardInterrupt(), 130, "vascval: interrupted"),
    ],
)
def test_errors_end_in_one_line(error, code, message, monkeypatch, capsys):
    assert failing(monkeypatch, error) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(message)
    assert err.count("\n") == 1


def test_error_of_the_program_itself_is_not_swallowed(monkeypatch):
    with pytest.raises(ZeroDivisionError, match="by nought"):
        failing(monkeypatch, ZeroDivisionError("by nought"))


def of_compiled_code(cause: BaseException | None) -> SystemError:
    """What comes of an exception that is raised while compiled code calls Python, twice over."""
    for text in ("unpickle returned a result with an exception set", "kernel returned a result with an exception set"):
        error = SystemError(text)
        error.__cause__, cause = cause, error
    return error


def test_signal_in_compiled_code_is_a_signal(monkeypatch, capsys):
    assert failing(monkeypatch, of_compiled_code(KeyboardInterrupt())) == 130
    assert capsys.readouterr() == ("", "vascval: interrupted; no unfinished file is left behind\n")
    with pytest.raises(SystemError, match="kernel returned a result"):
        failing(monkeypatch, of_compiled_code(ValueError("a fault")))


@pytest.mark.parametrize("place", [["--debug", "schema"], ["schema", "--debug"]])
def test_debug_shows_the_traceback(place, monkeypatch, capsys):
    def names():
        raise InputError("wrong")

    monkeypatch.setattr("vascval.io.schemas.names", names)
    assert main(place) == 2
    err = capsys.readouterr().err
    assert "Traceback" in err
    assert err.endswith("vascval: error: wrong\n")


def test_notes_are_silenced(monkeypatch, capsys):
    monkeypatch.setattr("vascval.cli.schema.names", lambda: console.note("mind this") or ["one"])
    assert main(["schema"]) == 0
    assert capsys.readouterr() == ("one\n", "vascval: note: mind this\n")
    assert main(["schema", "--quiet"]) == 0
    assert capsys.readouterr() == ("one\n", "")


def test_no_bars_where_stderr_is_no_terminal(monkeypatch, capsys):
    def names():
        with console.progress() as observer:
            return [str(observer)]

    monkeypatch.setattr("vascval.cli.schema.names", names)
    assert main(["schema"]) == 0
    assert capsys.readouterr() == ("None\n", "")


def test_unforeseen_error_is_one_line_for_the_user(tmp_path):
    script = (
        "import sys, vascval.io.schemas as schemas\n"
        "from vascval.cli.main import main\n"
        "def names(): raise ZeroDivisionError('by nought')\n"
        "schemas.names = names\n"
        "sys.exit(main())\n"
    )
    command = [sys.executable, "-c", script, "schema"]
    plain = subprocess.run(command, capture_output=True, text=True, check=False)
    assert plain.returncode == 1
    assert plain.stderr.startswith("vascval: error: internal error, ZeroDivisionError: by nought;")
    assert plain.stderr.count("\n") == 1
    debug = subprocess.run([*command, "--debug"], capture_output=True, text=True, check=False)
    assert debug.returncode == 1
    assert "Traceback" in debug.stderr


def test_reader_that_leaves_early_is_no_error():
    command = f"{sys.executable} -m vascval.cli schema | true; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=True)
    assert done.stdout == "0\n"
    assert done.stderr == ""


@pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX shell")
def test_closed_streams_are_no_error():
    command = f"{sys.executable} -m vascval.cli schema"
    for closed, code in ((">&-", 0), ("2>&-", 0), (">&- 2>&-", 0), ("nonsense 2>&-", 2)):
        done = subprocess.run(["bash", "-c", f"{command} {closed}"], capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (code, "")
        assert (done.stdout != "") == (closed == "2>&-")  # no complaint among the results


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs the device /dev/full")
def test_full_disk_is_said():
    with open("/dev/full", "w") as full:
        done = subprocess.run([*VASCVAL, "schema"], stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("vascval: error: No space left on device")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signals(number, code, tmp_path):
    """A run interrupted in the middle of writing its outputs leaves nothing behind."""
    script = (
        "import sys, time, vascval.io.schemas as schemas\n"
        "from vascval.cli.main import main\n"
        "from vascval.io.atomic import atomic_directory, atomic_file\n"
        "from pathlib import Path\n"
        "def names():\n"
        "    with atomic_directory(Path('report')) as folder, atomic_file(Path('tree.vtp')) as file:\n"
        "        Path(file).write_text('half')\n"
        "        (Path(folder) / 'half.csv').write_text('half')\n"
        "        print('ready', file=sys.stderr, flush=True)\n"
        "        time.sleep(60)\n"
        "schemas.names = names\n"
        "sys.exit(main())\n"
    )
    command = [sys.executable, "-c", script, "schema"]
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    assert process.stderr.readline() == "ready\n"
    time.sleep(0.1)
    os.kill(process.pid, number)
    _, err = process.communicate(timeout=20)
    assert process.returncode == code
    assert err == "vascval: interrupted; no unfinished file is left behind\n"
    assert list(tmp_path.iterdir()) == []


def test_within_another_program(monkeypatch, capsys):
    """On a thread, where no handler can be set, and beside handlers of its own, which stay."""
    codes: list[int] = []
    worker = threading.Thread(target=lambda: codes.append(main(["schema"])))
    worker.start()
    worker.join()
    assert codes == [0]

    def own(*_):
        raise AssertionError("nobody sent a signal")

    before = signal.signal(signal.SIGTERM, own)
    try:
        assert main(["schema"]) == 0
        assert signal.getsignal(signal.SIGTERM) is own
    finally:
        signal.signal(signal.SIGTERM, before)


def test_signals_that_are_ignored_stay_ignored():
    """As ``nohup`` asks for; the others wait for the step."""
    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        with held_back(unless=lambda: False) as held:
            os.kill(os.getpid(), signal.SIGTERM)
            held.release()
            assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
            os.kill(os.getpid(), signal.SIGINT)
            with pytest.raises(KeyboardInterrupt):
                held.release()
    finally:
        signal.signal(signal.SIGTERM, before)


def test_runs_on_a_thread_leave_signals_alone():
    before = signal.getsignal(signal.SIGINT)
    seen: list[object] = []

    def run():
        with held_back(unless=lambda: False) as held:
            seen.append(signal.getsignal(signal.SIGINT))
            held.release()

    worker = threading.Thread(target=run)
    worker.start()
    worker.join()
    assert seen == [before]
