"""Units. Inside, everything is in g, mm and s: pressure is then Pa (g mm^-1 s^-2) and Poiseuille needs no factor."""

from __future__ import annotations

PA_PER_MMHG = 133.322387415
MM3_S_PER_ML_MIN = 1000.0 / 60.0
PA_S_PER_CP = 1e-3
MM_PER = {"m": 1000.0, "cm": 10.0, "mm": 1.0, "um": 1e-3}
"""Millimetres in one of each length unit that readers accept."""
