"""Friction of single joints, from recordings in which one joint moves at a time."""
