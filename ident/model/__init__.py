"""The arm: its geometry, loops and couplings, its parameters, and the regressors that are linear in them."""
