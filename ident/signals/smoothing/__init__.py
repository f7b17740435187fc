"""Smoothing of sampled signals, with their derivatives: Kalman, Savitzky-Golay, five-point cubic."""
