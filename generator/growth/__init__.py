"""Constrained constructive optimisation."""
