"""Tables of motor families: scaling of each model, faults, and the document that says so, from the files beside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from drivers.core.validation import load_yaml

FAMILIES = ("damiao", "robstride", "cubemars", "moteus", "odrive")
"""Families of motors, each a driver of its own name."""


@dataclass(frozen=True)
class MotorModel:
    """What full scale in a model's frames is, at its output shaft; None where its frames carry plain numbers.

    Attributes:
        position: ± [rad].
        velocity: ± [rad/s].
        torque: ± [N·m].
        kp: from 0 [N·m/rad].
        kd: from 0 [N·m·s/rad].
        torque_constant: [N·m/A] of the motor before its gear; None where no document says it.
    """

    position: float | None = None
    velocity: float | None = None
    torque: float | None = None
    kp: float | None = None
    kd: float | None = None
    torque_constant: float | None = None


@dataclass(frozen=True)
class MotorFamily:
    """What the documents say of a family of motors.

    Attributes:
        name: of the family and its driver.
        models: name in robot files → scaling.
        faults: number of a fault, or of its bit → what it means.
        bits: whether a fault is a set of bits.
        documents: what says so.
    """

    name: str
    models: Mapping[str, MotorModel]
    faults: Mapping[int, str]
    bits: bool
    documents: Mapping[str, str]

    def fault_words(self, code: int) -> list[str]:
        """What a fault code means; empty where it means none."""
        if not self.bits:
            return [self.faults.get(code, f"fault {code}")] if code else []
        told = [words for bit, words in self.faults.items() if code >> bit & 1]
        return told or ([f"fault 0x{code:X}"] if code else [])


@cache
def motor_family(name: str) -> MotorFamily:
    """The table of one of `FAMILIES`."""
    content = load_yaml((files(__package__) / "tables" / f"{name}.yaml").read_text("utf-8"))
    common = content.get("all", {})
    models = {model: MotorModel(**(common | (own or {}))) for model, own in content["models"].items()}
    return MotorFamily(name, models, content["faults"], content.get("bits", False), content["documents"])
