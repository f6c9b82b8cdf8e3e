"""Measures of one tree, one definition each, used for cast and synthetic trees alike."""
