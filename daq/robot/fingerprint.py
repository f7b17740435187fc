"""Which sections of a robot file a motion was designed for, so that a file changed since can be named."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping

from daq.robot.schema import Robot

SECTIONS = ("joints", "model", "workspace", "payload", "truth")
"""What limits, clearances and predicted torques of a motion depend on."""
_DIGITS = 12


def fingerprint(robot: Robot, urdf_text: str | None = None) -> dict[str, str]:
    """Section → the first digits of the SHA-256 of what it says; also of a URDF."""
    content = robot.model_dump(mode="json", include=set(SECTIONS))
    texts = {name: json.dumps(content.get(name), sort_keys=True) for name in SECTIONS}
    if urdf_text is not None:
        texts["urdf"] = urdf_text
    return {name: hashlib.sha256(text.encode()).hexdigest()[:_DIGITS] for name, text in texts.items()}


def changed_since(designed_for: Mapping[str, str], robot: Robot, urdf_text: str | None = None) -> str:
    """Which of the sections known differ from those that a motion was designed for, in words; empty where none does."""
    now = fingerprint(robot, urdf_text)
    differ = [name for name, digits in designed_for.items() if now.get(name, digits) != digits]
    return f"the robot file changed since the motion was designed: {', '.join(differ)}" if differ else ""
