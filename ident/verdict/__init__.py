"""What was checked, and what follows from it: checks, their catalogue, the verdict."""
