"""Arms on a CAN bus of their maker's own making: what each frame holds is told by a table or a DBC file."""
