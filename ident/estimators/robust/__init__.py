"""Robust least squares on equations whitened across the joints (AUBO eq. 11 to 14)."""
