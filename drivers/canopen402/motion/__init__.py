"""Moving and stopping the drives."""
