"""Ranges for domain randomisation: what the data leave open about an arm, as boxes and as a Gaussian."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.servo.result import ServoResult
from ident.servo.terms import INDEX, TERMS, from_search, to_search

SCHEMA = 1

MJCF_PLACES = {
    "stiffness": "actuator gainprm[0], and biasprm[1] = -stiffness",
    "damping": "joint damping",
    "armature": "joint armature",
    "coulomb": "joint frictionloss",
    "bias": "actuator biasprm[0] = -stiffness·bias",
    "delay": "actuator delay",
    "torque_limit": "actuator forcerange",
    "zero": "joint ref = -zero",
}
"""Where MuJoCo has a parameter."""


@dataclass(frozen=True)
class UnitRange:
    """A parameter's 95 % box, in its unit."""

    value: float
    low: float
    high: float


def unit_ranges(result: ServoResult, unit_spread: float) -> dict[str, dict[str, UnitRange]]:
    """Joint → parameter → 95 % box; with what units of one type differ by, added in quadrature.

    What the data do not tell stays at its value.

    Args:
        result: of the identification.
        unit_spread: σ of the logarithms of positive parameters from unit to unit; 0 for this arm alone.
    """
    boxes: dict[str, dict[str, UnitRange]] = {}
    for joint in result.servo:
        own = boxes.setdefault(joint.joint, {})
        for name, parameter in joint.parameters.items():
            known = parameter.interval is not None and not parameter.unidentifiable
            low, high = (parameter.interval if known else None) or (parameter.value, parameter.value)
            if unit_spread > 0 and TERMS[INDEX[name]].positive:
                ends = np.log(np.array([low, high]) / parameter.value)
                low, high = (
                    parameter.value * np.exp(np.array([-1.0, 1.0]) * np.hypot(ends, WITHIN_95_PERCENT * unit_spread))
                ).tolist()
            own[name] = UnitRange(parameter.value, float(low), float(high))
    return boxes


def gaussians(result: ServoResult, unit_spread: float) -> dict[str, dict[str, object]]:
    """Joint → mean and factor of a Gaussian of its searched parameters, with names, scales and boxes.

    A draw is mean + factor·standard normal; exponentials of it where `logarithm` is true; within `box`.
    """
    described = {}
    boxes = unit_ranges(result, unit_spread)
    for row, joint in enumerate(result.servo):
        order = result.searched[row]
        if not order:
            continue
        columns = [INDEX[name] for name in order]
        covariance = with_spread(result, row, unit_spread)
        powers, axes = np.linalg.eigh(covariance)
        described[joint.joint] = {
            "order": order,
            "logarithm": [TERMS[column].positive for column in columns],
            "mean": to_search(result.values[row])[columns].tolist(),
            "factor": (axes * np.sqrt(np.maximum(powers, 0.0))).ravel().tolist(),
            "box": [[boxes[joint.joint][name].low, boxes[joint.joint][name].high] for name in order],
        }
    return described


def with_spread(result: ServoResult, row: int, unit_spread: float) -> FloatArray:
    """Covariance of a joint's searched parameters, with that of units of its type added."""
    covariance = np.array(result.covariance[row], dtype=np.float64).reshape(len(result.searched[row]), -1)
    positive = np.array([TERMS[INDEX[name]].positive for name in result.searched[row]], dtype=np.float64)
    return np.asarray(covariance + np.diag(unit_spread**2 * positive), dtype=np.float64)


def servo_ranges(result: ServoResult, unit_spread: float) -> dict[str, object]:
    """The object of `export --ranges`: per joint the 95 % box of each parameter, and their covariance.

    The covariance is of `order`, of logarithms where `logarithm` says so: draw from it, take exponentials, and the
    parameters vary together as the recordings allow. `mjcf` says where MuJoCo has the parameter. It is of this arm, and
    of other units of its type as far as `unit_spread` says.
    """
    boxes = unit_ranges(result, unit_spread)
    joints = []
    for row, joint in enumerate(result.servo):
        parameters = {}
        for name, parameter in joint.parameters.items():
            box = boxes[joint.joint][name]
            parameters[name] = {
                "value": box.value,
                "low": box.low,
                "high": box.high,
                "unit": parameter.unit,
                "logarithm": TERMS[INDEX[name]].positive,
                "unidentifiable": parameter.unidentifiable,
                "mjcf": MJCF_PLACES.get(name),
            }
        covariance = with_spread(result, row, unit_spread).tolist() if result.searched[row] else []
        joints.append(
            {"joint": joint.joint, "parameters": parameters, "order": result.searched[row], "covariance": covariance}
        )
    return {
        "dynid_schema": SCHEMA,
        "kind": "servo-ranges",
        "robot": result.robot,
        "unit_spread": unit_spread,
        "joints": joints,
    }


def drawn(result: ServoResult, seed: int, unit_spread: float) -> FloatArray:
    """(n, terms) parameters drawn from the covariance, each within its 95 % box; unidentifiable ones stay."""
    generator = np.random.default_rng(seed)
    values, boxes = result.values, unit_ranges(result, unit_spread)
    for row, joint in enumerate(result.servo):
        order = result.searched[row]
        if not order:
            continue
        columns = [INDEX[name] for name in order]
        point = to_search(values[row])
        point[columns] += generator.multivariate_normal(
            np.zeros(len(order)), with_spread(result, row, unit_spread), method="eigh"
        )
        sampled = from_search(point)
        for name, column in zip(order, columns, strict=True):
            if not joint.parameters[name].unidentifiable:
                box = boxes[joint.joint][name]
                values[row, column] = np.clip(sampled[column], box.low, box.high)
    return values
