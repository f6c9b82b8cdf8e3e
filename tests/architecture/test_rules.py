"""The house rules that a machine can check."""

import ast
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted([*ROOT.glob("vascval/**/*.py"), *ROOT.glob("generator/**/*.py")])
KERNELS = [path for path in SOURCES if re.fullmatch(r"_(\w+_)?kernels\.py", path.name)]
HEAVY = ("numpy", "numba", "pandas", "scipy", "SimpleITK", "vtk", "vtkmodules", "pyvista", "matplotlib", "plotly",
         "skimage", "dask", "distributed", "pydantic", "jinja2", "rich")  # fmt: skip
MAX_FILE_LINES = 400
MAX_FUNCTION_LINES = 60


def relative(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def test_sources_are_found():
    assert len(SOURCES) > 20
    assert len(KERNELS) >= 2


def test_imports_point_downwards():
    done = subprocess.run(
        [str(Path(sys.executable).with_name("lint-imports")), "--no-cache"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 broken" in done.stdout


@pytest.mark.parametrize("path", KERNELS, ids=relative)
def test_kernels_import_little(path):
    allowed = {"numpy", "math", "numba", "vascval.core.jit", "vascval.core.borrowing", "__future__", "typing"}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names = {node.module}
        else:
            continue
        other = {name for name in names - allowed if not re.search(r"(^|\.)_(\w+_)?kernels$", name or "")}
        assert not other, f"{relative(path)}:{node.lineno} imports {other}"


def test_files_are_short():
    long = {relative(path): n for path in SOURCES if (n := len(path.read_text("utf-8").splitlines())) > MAX_FILE_LINES}
    assert not long


def lines_of(node: ast.stmt) -> int:
    return (node.end_lineno or 0) - node.lineno + 1


def test_functions_are_short():
    """Docstrings are not counted: a long explanation is no fault."""
    long = []
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                docstring = node.body[0] if ast.get_docstring(node) is not None else None
                n = lines_of(node) - (lines_of(docstring) if docstring else 0)
                if n > MAX_FUNCTION_LINES:
                    long.append(f"{relative(path)}:{node.lineno} {node.name} has {n} lines")
    assert not long


def tracked_files() -> list[Path]:
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("needs a git checkout to know which files belong to the project")
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [ROOT / name for name in listed.split("\0") if name and (ROOT / name).is_file()]


def test_no_path_of_a_machine_is_committed():
    machine = re.compile(rb"(?<![\w.:/<])/(?:home|work|Users|root|opt|mnt)/[\w.]")
    found = []
    for path in tracked_files():
        if path == Path(__file__).resolve():
            continue
        for number, line in enumerate(path.read_bytes().splitlines(), 1):
            if machine.search(line):
                found.append(f"{relative(path)}:{number}: {line[:100]!r}")
    assert not found


def in_fresh_python(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout


def seconds_to_run(code: str) -> float:
    """Time that ``code`` takes inside a fresh interpreter, its start-up not counted; the best of five."""
    script = f"import time; t = time.perf_counter(); {code}; print(time.perf_counter() - t)"
    return min(float(in_fresh_python(script).splitlines()[-1]) for _ in range(5))


def test_import_is_light():
    script = f"import vascval, sys; print([name for name in {HEAVY} if name in sys.modules])"
    assert in_fresh_python(script).strip() == "[]"
    assert seconds_to_run("import vascval") < 0.3  # the design's limit; about 0.001 s without heavy imports


def test_command_line_starts_light():
    script = (
        "import sys, contextlib, io\n"
        "from vascval.cli.main import main\n"
        "with contextlib.redirect_stdout(io.StringIO()) as out: code = main(['--help'])\n"
        "assert code == 0 and 'compare' in out.getvalue()\n"
        f"print([name for name in {HEAVY} if name in sys.modules])"
    )
    assert in_fresh_python(script).strip() == "[]"
    # the whole process within 0.5 s, of which the bare interpreter takes up to 0.1; about 0.06 s without heavy imports
    assert seconds_to_run("from vascval.cli.main import main; main(['--help'])") < 0.4
