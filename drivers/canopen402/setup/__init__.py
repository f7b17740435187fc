"""Configuration of the drives before anything is recorded."""
