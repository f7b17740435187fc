"""A check that was raised: something that a user should know before trusting a recording or a model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

Purpose = Literal["torque_prediction", "simulation", "collision_detection", "payload_estimation"]
"""What a dynamic model is used for; feed-forward control is torque prediction."""

PURPOSES: tuple[Purpose, ...] = get_args(Purpose)
PURPOSE_WORDS: dict[Purpose, str] = {
    "torque_prediction": "torque prediction (feed-forward)",
    "simulation": "simulation",
    "collision_detection": "collision detection",
    "payload_estimation": "payload estimation",
}

Severity = Literal["note", "warning", "serious"]
"""`note`: to know, nothing is spoilt. `warning`: the purposes named are usable at best. `serious`: they are poor."""

SEVERITIES: tuple[Severity, ...] = get_args(Severity)
"""From the mildest to the worst."""


@dataclass(frozen=True)
class Check:
    """One check of the catalogue, raised by a recording or an identification.

    Attributes:
        name: stable, as in docs/checks.md.
        severity: what it does to the purposes named.
        purposes: that it spoils; empty for a note.
        text: what was seen, with its figures, and what to do: one sentence.
        joints: names of the joints that it concerns; empty where it concerns the whole arm.
    """

    name: str
    severity: Severity
    purposes: tuple[Purpose, ...]
    text: str
    joints: tuple[str, ...] = ()


def texts(checks: tuple[Check, ...]) -> list[str]:
    """The sentences of the checks that spoil something."""
    return [check.text for check in checks if check.severity != "note"]
