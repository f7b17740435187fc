"""From SYNC to rows of samples."""
