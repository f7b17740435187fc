"""From recordings to models, one or many."""
