"""SimpleITK behind a guard: what it prints is caught, and its errors become one line."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vascval.core.errors import InputError
from vascval.io.header_checks import Header, Raster, require_shape
from vascval.io.quiet import printed

_LONGEST_TEXT = 4000  # longer values overflow what readers of MetaImage headers hold


def read_image(
    path: Path, files: Sequence[Path], header: Header, require_memory: Callable[[Sequence[int], int], None]
) -> Raster:
    """The voxels of a file, or of the slices of a folder, held once.

    :param require_memory: called with the size and the bytes per value before the voxels are read; raises to refuse.
    :raises InputError: when there are not three axes of one real value each, or the library fails or complains.
    """
    import SimpleITK as sitk

    reader = _reader(files[0], header)
    is_stack = path.is_dir()
    with printed() as complaint:
        try:
            reader.ReadImageInformation()
            size = list(reader.GetSize())
            notes = require_shape(path, size, is_stack, reader.GetNumberOfComponents())
            itemsize = _itemsize(path, sitk, reader.GetPixelID())
            require_memory([*size[:2], len(files)] if is_stack else size, itemsize)
            if is_stack:
                series = sitk.ImageSeriesReader()
                series.SetImageIO(header.reader)
                series.SetFileNames([str(file) for file in files])
                image = series.Execute()
            else:
                reader.SetExtractSize(size[:3] + [0] * (len(size) - 3))
                image = reader.Execute()
        except (RuntimeError, MemoryError) as error:
            raise InputError(f"{path}: {_reason(error, header.kind)}") from error
        if complaint():
            raise InputError(f"{path}: cannot be read as {header.kind} ({complaint()[:160]}); it is damaged")
    return _raster(np.asarray(_Pixels(image)), image, notes)


def read_frame(path: Path, file: Path, header: Header) -> Raster | None:
    """Place and notes of an image, with one voxel for its values; ``None`` if its size is not that of the header."""
    reader = _reader(file, header)
    with printed() as complaint:
        try:
            reader.ReadImageInformation()
        except RuntimeError as error:
            raise InputError(f"{path}: {_reason(error, header.kind)}") from error
        if complaint():
            raise InputError(f"{path}: cannot be read as {header.kind} ({complaint()[:160]}); it is damaged")
    if tuple(reader.GetSize()) != header.sizes or reader.GetNumberOfComponents() != 1:
        return None
    return _raster(np.zeros((1, 1, 1), dtype=np.uint8), reader, [])


def _reader(file: Path, header: Header) -> Any:
    import SimpleITK as sitk

    sitk.ProcessObject.SetGlobalWarningDisplay(False)
    reader = sitk.ImageFileReader()
    reader.SetImageIO(header.reader)
    reader.SetFileName(str(file))
    return reader


def _raster(values: np.ndarray, source: Any, notes: list[str]) -> Raster:
    return Raster(
        values=values,
        spacing=np.array(source.GetSpacing()),
        origin=np.array(source.GetOrigin()),
        direction=np.array(source.GetDirection()).reshape(3, 3),
        notes=notes,
    )


def _itemsize(path: Path, sitk: Any, pixel: int) -> int:
    if "complex" in sitk.GetPixelIDValueAsString(pixel):
        raise InputError(f"{path}: has complex values; real ones are needed, take the magnitude")
    return sitk.Image([1, 1, 1], pixel).GetSizeOfPixelComponent()


def _reason(error: BaseException, kind: str) -> str:
    if isinstance(error, MemoryError) or "allocat" in str(error).lower():
        return "does not fit into memory; crop or downsample it"
    said = [line.strip() for line in str(error).splitlines() if line.strip()]
    last = re.sub(r"^.*(ERROR|Exception)[^:]*:\s*", "", said[-1]) if said else "no reason given"
    return f"cannot be read as {kind} ({last.rstrip('.')[:160]}); it is truncated or damaged, get it again"


class _Pixels:
    """Pixels of an image for NumPy: the array made from it keeps the image alive, so that nothing is copied."""

    def __init__(self, image: Any) -> None:
        import SimpleITK as sitk

        self.image = image
        self.__array_interface__ = sitk.GetArrayViewFromImage(image).__array_interface__


def write_image(
    path: Path,
    values: np.ndarray,
    spacing_mm: np.ndarray,
    origin_mm: np.ndarray,
    direction: np.ndarray,
    texts: Mapping[str, str],
) -> None:
    """Voxels (nz, ny, nx) with their frame, compressed where the format knows how; texts as far as they fit.

    :raises RuntimeError: when the library cannot write them.
    """
    import SimpleITK as sitk

    sitk.ProcessObject.SetGlobalWarningDisplay(False)
    image = sitk.GetImageFromArray(values.astype(values.dtype.newbyteorder("="), copy=False))
    image.SetSpacing(spacing_mm.tolist())
    image.SetOrigin(origin_mm.tolist())
    image.SetDirection(direction.ravel().tolist())
    for name, text in texts.items():
        if len(text) < _LONGEST_TEXT:
            image.SetMetaData(name, text)
    with printed():
        sitk.WriteImage(image, str(path), useCompression=True)
