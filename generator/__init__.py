"""Growth and optimisation of synthetic vascular trees (Jessen, Steinbach, Debbaut, Schillinger 2022)."""
