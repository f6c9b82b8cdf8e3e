"""Cast against synthetic trees: generation by generation, distributions, location."""
