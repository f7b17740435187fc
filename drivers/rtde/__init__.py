"""Universal Robots arms: recording by our own RTDE reader, motion by ur_rtde in a process of its own."""
