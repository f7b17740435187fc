"""From frames to rows of samples."""
