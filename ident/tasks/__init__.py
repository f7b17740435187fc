"""The tasks of a user, one call each, from Python and from the command line."""
