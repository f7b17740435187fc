"""Files of a servo model for simulators: MJCF, Isaac Lab, USD, and how near they move to it."""
