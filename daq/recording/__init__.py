"""The recording: its HDF5 file, written, read, rescued and judged."""
