"""The page of a designed excitation."""
