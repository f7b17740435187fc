"""What a model is good for."""
