"""Many trees: seeds and grids of parameters, on local processes or a Dask cluster."""
