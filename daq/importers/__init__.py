"""Other people's files as recordings; a reader a file format."""
