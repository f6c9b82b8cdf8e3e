"""Volumes whose values lie in files packed with gzip: unpacked from the beginning to the end, slice after slice."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path
from typing import BinaryIO

import numpy as np

from vascval.core.errors import InputError
from vascval.io.header_checks import Flat


class PackedReader:
    """Reads whole slices in their order; see ``read`` of :class:`vascval.io.scans.Scan`.

    Who asks for a slice that has passed has the file unpacked anew from its beginning.
    """

    def __init__(self, path: Path, flat: Flat) -> None:
        self.path, self.flat = path, flat
        self.dtype = flat.dtype.newbyteorder("=")
        self._stream: gzip.GzipFile | None = None
        self._raw: BinaryIO | None = None
        self._file, self._at = -1, 0

    def __call__(self, z0: int, z1: int, y0: int, y1: int) -> np.ndarray:
        _, ny, nx = self.flat.shape
        values = np.empty((z1 - z0, ny, nx), dtype=self.flat.dtype)
        for z in range(z0, z1):
            name = self.flat.files[int(self.flat.file[z])].name
            try:
                filled = self._fill(z, values[z - z0].view(np.uint8).reshape(-1))
            except (OSError, EOFError, zlib.error) as error:
                self._close()
                reason = f"{name} cannot be unpacked ({error})"
                raise InputError(f"{self.path}: {reason}; it is truncated or damaged, get it again") from error
            if filled < values[0].nbytes:
                raise InputError(f"{self.path}: {name} ends within slice {z}; it is truncated, get it again")
        if z1 == self.flat.shape[0]:
            self._close()
        return values[:, y0:y1].astype(self.dtype, copy=False)

    def _fill(self, z: int, target: np.ndarray) -> int:
        """Unpacks a slice into the bytes ``target``; how many there were. Ends the file after its last slice."""
        file, start = int(self.flat.file[z]), int(self.flat.start[z])
        if self._stream is None or file != self._file or start < self._at:
            self._open(file)
        assert self._stream is not None
        while self._at < start:
            skipped = len(self._stream.read(min(start - self._at, 1 << 20)))
            if skipped == 0:
                return 0
            self._at += skipped
        filled = 0
        while filled < target.size and (n := self._stream.readinto(target[filled:].data)):
            filled += n
        self._at += filled
        if z + 1 == self.flat.shape[0] or self.flat.file[z + 1] != file:
            self._stream.read(1)  # makes it hold the checksum against what was unpacked
        return filled

    def _open(self, file: int) -> None:
        self._close()
        self._raw = self.flat.files[file].open("rb")
        self._raw.seek(self.flat.packed_at or 0)
        self._stream = gzip.GzipFile(fileobj=self._raw)
        self._file, self._at = file, 0

    def _close(self) -> None:
        for stream in (self._stream, self._raw):
            if stream is not None:
                stream.close()
        self._stream = self._raw = None
