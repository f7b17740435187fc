"""What `dynid sim` serves, and until when."""
