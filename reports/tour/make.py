"""Makes the pictures of the README's tour with the commands it shows: ``python -m reports.tour.make``."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

HERE = Path(__file__).resolve().parent
FROM_DEMO = ("overlay.png", "n-segments.png", "radius-mean.png", "branching-ratio-mean.png")


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        run("demo", "--quiet", "-o", work / "demo")
        for picture in FROM_DEMO:
            shrink(work / "demo" / "figures" / picture, HERE / picture)
        run("generate", "karch-box", "--quiet", "--set", "n_terminals=2000", "-o", work / "box.vtp")
        run("view", work / "box.vtp", "--screenshot", work / "box.png")
        shrink(work / "box.png", HERE / "box.png")


def run(*words: str | Path) -> None:
    """The command line, of this Python."""
    program = [sys.executable, "-m", "vascval.cli"]
    subprocess.run([*program, *(str(word) for word in words)], check=True, stdout=subprocess.DEVNULL)


def shrink(source: Path, target: Path, *, width: int = 1000) -> None:
    """A picture at most ``width`` pixels wide, in 128 colours: a tenth of the bytes."""
    with Image.open(source) as picture:
        small = picture.convert("RGB")
        if small.width > width:
            small = small.resize((width, round(small.height * width / small.width)), Image.Resampling.LANCZOS)
        small.quantize(128).save(target, optimize=True)


if __name__ == "__main__":
    main()
