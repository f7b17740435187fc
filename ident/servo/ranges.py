"""Ranges for domain randomisation: what the data leave open about an arm, as boxes and as a Gaussian."""

from __future__ import annotations

import numpy as np

from drivers.core.arrays import FloatArray
from ident.servo.result import ServoResult
from ident.servo.terms import INDEX, TERMS, from_search, to_search

SCHEMA = 1


def servo_ranges(result: ServoResult) -> dict[str, object]:
    """The object of `export --ranges`: per joint the 95 % box of each parameter, and their covariance.

    The covariance is of `order`, of logarithms where `logarithm` says so: draw from it, take exponentials, and the
    parameters vary together as the recordings allow. It is of this arm, not of other units of its type.
    """
    joints = []
    for joint, order, covariance in zip(result.servo, result.searched, result.covariance, strict=True):
        parameters = {}
        for name, parameter in joint.parameters.items():
            low, high = parameter.interval or (parameter.value, parameter.value)
            parameters[name] = {
                "value": parameter.value,
                "low": low,
                "high": high,
                "unit": parameter.unit,
                "logarithm": TERMS[INDEX[name]].positive,
                "unidentifiable": parameter.unidentifiable,
            }
        joints.append({"joint": joint.joint, "parameters": parameters, "order": order, "covariance": covariance})
    return {"dynid_schema": SCHEMA, "kind": "servo-ranges", "robot": result.robot, "joints": joints}


def drawn(result: ServoResult, seed: int) -> FloatArray:
    """(n, terms) parameters drawn from the covariance, each within its 95 % interval."""
    generator = np.random.default_rng(seed)
    values = result.values
    for row, (joint, order, covariance) in enumerate(
        zip(result.servo, result.searched, result.covariance, strict=True)
    ):
        if not order:
            continue
        columns = [INDEX[name] for name in order]
        point = to_search(values[row])
        point[columns] += generator.multivariate_normal(np.zeros(len(order)), np.array(covariance), method="eigh")
        sampled = from_search(point)
        for name, column in zip(order, columns, strict=True):
            interval = joint.parameters[name].interval
            if interval is not None and not joint.parameters[name].unidentifiable:
                values[row, column] = np.clip(sampled[column], *interval)
    return values
