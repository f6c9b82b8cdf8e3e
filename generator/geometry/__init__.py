"""Optimal geometry of a whole tree at once, by two solvers (paper, section 2.3.1)."""
