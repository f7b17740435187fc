"""Thermometers that send lines of text over a serial line."""
