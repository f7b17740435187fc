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
    """What full scale in a model's frames is, at its output shaft; None where its frames carry plain numbers."""

    position: float | None = None  # ± [rad]
    velocity: float | None = None  # ± [rad/s]
    torque: float | None = None  # ± [N·m]
    kp: float | None = None  # from 0 [N·m/rad]
    kd: float | None = None  # from 0 [N·m·s/rad]
    torque_constant: float | None = None  # [N·m/A] of the motor before its gear; None where no document says it


@dataclass(frozen=True)
class MotorFamily:
    """What the documents say of a family of motors."""

    name: str  # of the family and its driver
    models: Mapping[str, MotorModel]  # name in robot files → scaling
    faults: Mapping[int, str]  # number of a fault, or of its bit → what it means
    bits: bool  # whether a fault is a set of bits
    documents: Mapping[str, str]  # what says so

    def fault_words(self, code: int) -> list[str]:
        """Return what a fault code means; empty where it means none."""
        if not self.bits:
            return [self.faults.get(code, f"fault {code}")] if code else []
        named = [words for bit, words in self.faults.items() if code >> bit & 1]
        return named or ([f"fault 0x{code:X}"] if code else [])


@cache
def motor_family(name: str) -> MotorFamily:
    """The table of one of `FAMILIES`."""
    content = load_yaml((files(__package__) / "tables" / f"{name}.yaml").read_text("utf-8"))
    common = content.get("all", {})
    models = {model: MotorModel(**(common | (own or {}))) for model, own in content["models"].items()}
    return MotorFamily(name, models, content["faults"], content.get("bits", False), content["documents"])
