"""Names of loops and lengths in messages."""

from __future__ import annotations

from daq.robot.loops import Loop


def loop_name(loop: Loop) -> str:
    """Name of a loop in messages."""
    if loop.parallelogram is not None:
        return f"parallelogram {', '.join(loop.parallelogram)}"
    return f"loop of {', '.join(loop.following)}"


def length(metres: float) -> str:
    """A length for a person."""
    return f"{metres * 1e3:.3g} mm" if metres < 1.0 else f"{metres:.3g} m"
