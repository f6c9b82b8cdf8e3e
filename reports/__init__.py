"""The paper's tables and figures, made anew: ``python -m reports.make``."""
