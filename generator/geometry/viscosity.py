"""Viscosity of blood by the radius of the vessel (Fåhraeus and Lindqvist; paper, formula (2), after Pries 1994)."""

from __future__ import annotations

import numpy as np

from generator.geometry import _viscosity_kernels as kernels
from vascval.core.errors import InputError
from vascval.core.units import PA_S_PER_CP


def fahraeus_lindqvist_pa_s(radius_mm: np.ndarray) -> np.ndarray:
    """Apparent viscosity in Pa s, same shape as ``radius_mm``; tends to 3.6 cP in wide vessels.

    In the formula 1.125 is the viscosity of plasma in cP and 0.00055 mm half the layer that cells do not enter.

    :raises InputError: when a radius is not beyond twice that, where the formula has lost its meaning.
    """
    radius = np.asarray(radius_mm, dtype=np.float64)
    if not (radius > 2.0 * kernels.DEPLETED_MM).all():
        raise InputError(
            f"a radius of {np.min(radius):g} mm is beyond the formula of viscosity, which needs more than "
            f"{2.0 * kernels.DEPLETED_MM:g} mm; widen the vessels or use constant viscosity"
        )
    return kernels.fahraeus_lindqvist_of(radius.ravel()).reshape(radius.shape) * PA_S_PER_CP
