"""A simulated arm that speaks a table of CAN signals."""
