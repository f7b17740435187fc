"""The recording: its HDF5 file, written, read and rescued."""
