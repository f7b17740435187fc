"""The built-in robot files."""
