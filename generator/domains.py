"""The domain that a configuration asks for."""

from __future__ import annotations

import numpy as np

from generator.config import DomainConfig
from generator.domain import Box, Domain
from generator.domain_shapes import ShapeDomain
from generator.domain_surface import SurfaceDomain
from generator.domain_volume import VoxelDomain
from generator.surface_files import SUFFIXES, read_surface
from vascval.core.errors import InputError
from vascval.io.volumes import is_volume_path, read_volume


def make_domain(config: DomainConfig) -> Domain:
    """:raises InputError: when the file is missing, foreign or damaged, or what it holds is no domain; it is named.
    Also for a label where there is no volume."""
    if config.label is not None and (config.file is None or config.file.suffix.lower() in SUFFIXES):
        here = "the domain is no file" if config.file is None else f"{config.file} is a surface"
        raise InputError(
            f"domain.label {config.label}: chooses a part of a label volume, but {here}; name a volume as domain.file, "
            "or leave domain.label out"
        )
    if config.box_mm is not None:
        return Box(np.array(config.box_mm))
    if config.shape is not None:
        return ShapeDomain(config.shape)
    assert config.file is not None
    path = config.file
    if not path.exists():
        raise InputError(f"{path}: no such file; check domain.file")
    try:
        if path.suffix.lower() in SUFFIXES:
            return SurfaceDomain(*read_surface(path), keep=config.keep)
        if is_volume_path(path):
            volume = read_volume(path)
            return VoxelDomain(volume, label=config.label, closing_mm=config.closing_mm, keep=config.keep)
    except InputError as error:
        text = str(error)
        raise InputError(text if text.startswith(str(path)) else f"{path}: {text}") from error
    raise InputError(
        f"{path}: neither a volume nor a surface by its name; volumes are NRRD, NIfTI, MetaImage or TIFF, surfaces "
        f"{', '.join(suffix[1:].upper() for suffix in SUFFIXES)}"
    )
