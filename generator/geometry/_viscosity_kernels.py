"""Compiled apparent viscosity behind :mod:`generator.geometry.viscosity`."""

import math

import numpy as np

from vascval.core.jit import njit

PLASMA_CP = 1.125
DEPLETED_MM = 0.00055


@njit
def fahraeus_lindqvist(radius):
    """Apparent viscosity in cP of blood in a vessel of that radius (mm), and its derivative by the logarithm of it."""
    gap = radius - DEPLETED_MM
    k = (radius / gap) ** 2
    k_log = -2.0 * k * DEPLETED_MM / gap
    power = 8.09 * radius**0.64
    steep, gentle = 6.0 * math.exp(-170.0 * radius), 2.44 * math.exp(-power)
    core = steep - gentle + 2.2
    core_log = -170.0 * radius * steep + 0.64 * power * gentle
    return PLASMA_CP * (k + k * k * core), PLASMA_CP * (k_log + 2.0 * k * k_log * core + k * k * core_log)


@njit
def factors(radius, free, constant_cp, factor, bend):
    """Per free segment: viscosity over the constant one, and its logarithmic derivative; False: a radius too small."""
    for i in range(1, radius.size):
        if not free[i]:
            continue
        if not radius[i] > 2.0 * DEPLETED_MM:
            return False
        value, slope = fahraeus_lindqvist(radius[i])
        factor[i] = value / constant_cp
        bend[i] = slope / value
    return True


@njit
def fahraeus_lindqvist_of(radius):
    result = np.empty(radius.size)
    for i in range(radius.size):
        result[i] = fahraeus_lindqvist(radius[i])[0]
    return result
