"""Arms on a CAN bus with a proprietary protocol, described by a signal table or a DBC file."""
