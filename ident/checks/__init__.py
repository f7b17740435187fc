"""What `dynid check` and `dynid info` find."""
