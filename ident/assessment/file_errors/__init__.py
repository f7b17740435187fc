"""What may be wrong in a robot file, estimated from a recording."""
