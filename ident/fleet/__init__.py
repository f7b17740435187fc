"""Many arms, recordings and methods in one call, on the cores of this computer or on a Dask cluster."""
