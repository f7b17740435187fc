"""What watches the drives while they run: heartbeats, guarding, silence, and what they report."""
