"""Commands that make models of recordings, one or many."""
