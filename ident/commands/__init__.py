"""Commands of the identification side."""
