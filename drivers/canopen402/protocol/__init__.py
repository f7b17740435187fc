"""What the standards define: the object dictionary, SDO, emergencies, the state machine of a drive."""
