"""Servo models: position-controlled joints identified from commanded and measured positions, without torque."""
