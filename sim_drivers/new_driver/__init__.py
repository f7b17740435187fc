"""`dynid driver new`: a package with a driver for a toy bus, to be made into one for another bus."""
