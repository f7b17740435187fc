"""Standard parameters of bodies that can exist, from identified base parameters."""
