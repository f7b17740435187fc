"""Servo drives on CANopen: CiA 301 (communication) and CiA 402 (drives)."""
