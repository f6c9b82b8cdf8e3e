"""Branch coverage, kernels included; ``python -m tests.branches --help``."""
