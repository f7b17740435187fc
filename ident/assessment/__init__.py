"""How good the data and the model are: excitation, delay, plausibility, prediction errors."""
