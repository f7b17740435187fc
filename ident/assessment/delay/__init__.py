"""Delay of the recorded torque against the recorded position."""
