"""The simulated arm: rigid bodies, friction, heat, drives, sensors."""
