"""What readers take at their peak, by the size of the file: a factor for each format, and hardly anything for a header
that claims more than there is."""

from __future__ import annotations

import gzip
import json
import struct
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.fuzz import seeds
from tests.fuzz.targets import TARGETS
from tests.fuzz.worker import Memory
from vascval.core.errors import InputError
from vascval.core.tree import Topology, Tree
from vascval.io.trees import write_swc, write_vtp
from vascval.io.volumes import read_volume

N = 20_000
SMALL = 24 << 20
"""Bytes that a refusal may take: a file is read into memory as a whole where it is text."""


def peak(read: Callable[[], object]) -> int:
    with Memory(tidy=True) as memory:
        read()
    if memory.peak == 0 and not Path("/proc/self/clear_refs").exists():
        pytest.skip("this system does not tell the peak of resident memory")
    return memory.peak


def comb() -> Tree:
    """A trunk with N / 2 side branches."""
    parent = np.maximum((np.arange(N) - 2) | 1, 0)
    parent[:2] = -1, 0
    rng = np.random.default_rng(1)
    return Tree(Topology(parent), rng.normal(size=(N, 3)), rng.random(N))


def big(name: str) -> bytes:
    """A sound file of that format, of a megabyte or more."""
    rng = np.random.default_rng(1)
    points = rng.normal(size=(N, 3)).round(4)
    text = "\n".join(f"{x} {y} {z}" for x, y, z in points.tolist())
    if name == "swc":
        return seeds.written("a.swc", lambda path: write_swc(comb(), path))
    if name == "vtp":
        return seeds.written("a.vtp", lambda path: write_vtp(comb(), path))
    if name == "vtk":
        head = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\n"
        head += f"POINTS {N} double\n{text}\nLINES {N - 1} {3 * N - 3}\n"
        lines = "\n".join(f"2 {i} {i + 1}" for i in range(N - 1))
        return (head + lines + f"\nPOINT_DATA {N}\nSCALARS radius double\nLOOKUP_TABLE default\n" + "1 " * N).encode()
    if name == "gxl":
        three = "<float>{}</float>" * 3
        node = f'<node id="{{}}"><attr name="position"><tup>{three}</tup></attr></node>'
        edge = '<edge from="{}" to="{}"><attr name="radius"><float>1</float></attr></edge>'
        nodes = "".join(node.format(i, *point) for i, point in enumerate(points.tolist()))
        return f"<gxl><graph>{nodes}{''.join(edge.format(i, i + 1) for i in range(N - 1))}</graph></gxl>".encode()
    if name == "points":
        return ("x_mm,y_mm,z_mm\n" + text.replace(" ", ",")).encode()
    if name == "reference":
        return ("generation,radius_mean_mm\n" + "".join(f"{i},1.5\n" for i in range(1, 2 * N))).encode()
    if name in ("stl", "obj"):
        return _sphere(name)
    sizes, count = b"128 128 64", 1 << 20
    voxels = rng.integers(0, 255, count).astype(np.uint8).tobytes()
    if name == "nrrd":
        return seeds.nrrd()[0].split(b"\n\n")[0].replace(b"4 3 2", sizes) + b"\n\n" + voxels
    if name == "mha":
        return seeds.mha()[1].split(b"LOCAL")[0].replace(b"4 3 2", sizes) + b"LOCAL\n" + zlib.compress(voxels)
    head = bytearray(seeds.nii()[0][:352])
    struct.pack_into("<8h", head, 40, 3, 128, 128, 64, 1, 1, 1, 1)
    return bytes(head) + voxels if name == "nii" else gzip.compress(bytes(head) + voxels, 1)


def _sphere(name: str) -> bytes:
    n = 70
    u, v = np.meshgrid(np.arange(n) * 2 * np.pi / n, np.arange(1, n) * np.pi / n)
    around = np.stack((np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)), axis=-1).reshape(-1, 3)
    points = 40 * np.concatenate((around, [[0, 0, 1], [0, 0, -1]]))
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n - 2), np.arange(n), indexing="ij"))
    a, b, c, d = i * n + j, i * n + (j + 1) % n, (i + 1) * n + j, (i + 1) * n + (j + 1) % n
    top, bottom, k = len(around), len(around) + 1, np.arange(n)
    faces = np.concatenate((
        np.stack((a, c, b), 1), np.stack((b, c, d), 1), np.stack((np.full(n, top), k, (k + 1) % n), 1),
        np.stack((np.full(n, bottom), (n - 2) * n + (k + 1) % n, (n - 2) * n + k), 1),
    ))  # fmt: skip
    if name == "obj":
        return ("".join("v {} {} {}\n".format(*p) for p in points) + "".join(
            "f {} {} {}\n".format(*f) for f in (faces + 1).tolist())).encode()  # fmt: skip
    record = np.zeros(len(faces), np.dtype([("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("attribute", "<u2")]))
    record["corner"] = points[faces]
    return bytes(80) + struct.pack("<I", len(faces)) + record.tobytes()


FACTOR = {
    "swc": 12, "vtp": 12, "vtk": 16, "gxl": 12, "points": 12, "reference": 170, "nrrd": 4, "mha": 6, "nii": 4,
    "nii.gz": 4, "stl": 30, "obj": 30,
}  # fmt: skip
"""Bytes of memory for each byte of a file of random values (which no packing makes small), at most."""


def test_memory_is_a_small_multiple_of_the_file() -> None:
    """In a process of its own: what others have freed would be used again and not be counted."""
    command = [sys.executable, "-m", "tests.fuzz.test_memory"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=Path(__file__).parents[2])
    used = json.loads(done.stdout)
    if not used:
        pytest.skip("this system does not tell the peak of resident memory")
    assert set(used) == set(FACTOR)
    for name, factor in used.items():
        assert 0.3 < factor < FACTOR[name], (name, factor)  # above a third: that it is measured at all


def measured() -> dict[str, float]:
    """Peak of memory over the size of the file for each format."""
    used = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in FACTOR:
            target = TARGETS[name]
            path = Path(folder, f"a{target.suffix}")
            for data in target.seeds():  # libraries are loaded and kernels compiled before anything is measured
                path.write_bytes(target.packed(data) if target.packed else data)
                target.read(path)
            path.write_bytes(big(name))
            with Memory(tidy=True) as memory:
                target.read(path)
            if memory.peak:
                used[name] = memory.peak / path.stat().st_size
    return used


def bombs() -> dict[str, bytes]:
    """Headers that claim a gigabyte."""
    giga = b"1000 1000 1000"
    plain, packed, ascii_, _ = (seed.replace(b"4 3 2", giga) for seed in seeds.nrrd())
    head = bytearray(seeds.nii()[0])
    struct.pack_into("<8h", head, 40, 3, 1000, 1000, 1000, 1, 1, 1, 1)
    return {
        "raw.nrrd": plain,
        "skip.nrrd": plain.replace(b"encoding: raw", b"encoding: raw\nbyte skip: 5"),
        "gzip.nrrd": packed,
        "ascii.nrrd": ascii_,
        "hex.nrrd": ascii_.replace(b"ascii", b"hex"),
        "bzip2.nrrd": ascii_.replace(b"ascii", b"bzip2"),
        "a.nii": bytes(head),
        "a.nii.gz": gzip.compress(bytes(head)),
        "raw.mha": seeds.mha()[0].replace(b"4 3 2", giga),
        "packed.mha": seeds.mha()[1].replace(b"4 3 2", giga),
    }


@pytest.mark.parametrize("name", bombs())
def test_a_header_that_claims_a_gigabyte_takes_no_memory(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(bombs()[name])

    def read() -> None:
        with pytest.raises(InputError, match=r"truncated|damaged|is not read"):
            read_volume(path, max_memory_bytes=2 << 30)

    assert peak(read) < SMALL


@pytest.mark.parametrize("suffix", [".nrrd", ".mha", ".nii.gz"])
def test_what_unpacks_to_more_than_the_header_says_is_not_unpacked(tmp_path: Path, suffix: str) -> None:
    path, zeros = tmp_path / f"a{suffix}", bytes(200_000_000)
    if suffix == ".mha":
        path.write_bytes(seeds.mha()[1].split(b"LOCAL")[0] + b"LOCAL\n" + zlib.compress(zeros, 1))
    elif suffix == ".nrrd":
        path.write_bytes(seeds.nrrd()[1].split(b"\n\n")[0] + b"\n\n" + gzip.compress(zeros, 1))
    else:
        path.write_bytes(gzip.compress(seeds.nii()[0] + zeros, 1))
    del zeros

    def read() -> None:
        try:
            assert read_volume(path).values.shape == (2, 3, 4)
        except InputError as error:
            assert "unpacks to more" in str(error)

    assert peak(read) < SMALL


if __name__ == "__main__":
    print(json.dumps(measured()))
