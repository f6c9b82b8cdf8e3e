"""Compiled sweeps behind :mod:`generator.haemodynamics`."""

import numpy as np

from vascval.core.jit import njit


@njit
def resistances(parent, length, n_terminals, gamma):
    """Leaf to root: ``rho`` and ``v`` of every segment, and ``S`` of every node (see the API module)."""
    size = parent.size
    total_s = np.zeros(size)
    total_t = np.zeros(size)
    rho = np.zeros(size)
    volume = np.zeros(size)
    for i in range(size - 1, 0, -1):
        rho[i] = n_terminals[i] * length[i]
        volume[i] = length[i]
        if total_s[i] > 0.0:
            root = total_s[i] ** (2.0 / gamma)
            rho[i] += root * root
            volume[i] += total_t[i] / root
        p = parent[i]
        total_s[p] += rho[i] ** (0.25 * gamma)
        total_t[p] += volume[i] * np.sqrt(rho[i])
    return rho, volume, total_s


@njit
def radii(parent, length, flow, fixed_radius, rho, total_s, terminal_flow, kappa, gamma, p_root, p_terminal):
    """Root to leaf: radius and distal pressure; a fixed radius is kept, where NaN the equal end pressure decides.

    Returns as third value the first segment that is left with no pressure drop to work with, -1 if there is none.
    """
    size = parent.size
    radius = np.zeros(size)
    pressure = np.empty(size)
    pressure[0] = p_root
    fixed = np.zeros(size, np.bool_)
    fixed[0] = True
    for i in range(1, size):
        p = parent[i]
        if fixed[p] and not np.isnan(fixed_radius[i]):
            fixed[i] = True
            radius[i] = fixed_radius[i]
        elif fixed[p]:
            drop = pressure[p] - p_terminal
            if not drop > 0.0:
                return radius, pressure, i
            radius[i] = (kappa * terminal_flow * rho[i] / drop) ** 0.25
        else:
            radius[i] = radius[p] * rho[i] ** 0.25 / total_s[p] ** (1.0 / gamma)
        pressure[i] = pressure[p] - kappa * flow[i] * length[i] / radius[i] ** 4
    return radius, pressure, -1
