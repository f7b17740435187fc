"""Commands of the acquisition side."""
