"""Names of the observers of the external torque, and their default, for commands that need no more of them."""

from __future__ import annotations

from typing import Literal

Kind = Literal["momentum", "direct", "kalman"]

BANDWIDTH: dict[Kind, float] = {"momentum": 70.0, "direct": 70.0, "kalman": 110.0}
"""Default K [1/s] of each observer: three quarters of a torque show after 20 ms."""
