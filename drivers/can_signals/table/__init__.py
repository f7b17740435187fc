"""What stands where in the frames: a signal table, or a DBC file."""
