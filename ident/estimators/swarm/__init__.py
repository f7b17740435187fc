"""Optimisers that need costs only, whole populations at a time, and the costs of identification for them."""
