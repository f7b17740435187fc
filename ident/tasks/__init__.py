"""A task a file: what a user asks for in one call, from Python or from the command line."""
