"""A simulated arm that is described by a table of CAN signals."""
