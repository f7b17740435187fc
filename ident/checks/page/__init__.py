"""The page of a recording: signals, clocks, spectra."""
