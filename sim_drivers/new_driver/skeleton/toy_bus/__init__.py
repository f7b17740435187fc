"""A driver for dynid: joints that report and obey on a CAN bus, a frame per joint and period."""
