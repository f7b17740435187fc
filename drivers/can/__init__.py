"""CAN through python-can: the bus, its adapters, when frames arrived."""
