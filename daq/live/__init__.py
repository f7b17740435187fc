"""What is shown of a recording while it runs."""
