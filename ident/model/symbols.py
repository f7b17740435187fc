"""Regrouping coefficients as formulas of the lengths that a robot file names: d3²·M4 in place of 0.4489·M4.

The regrouping is found numerically (module `base_parameters`), so the formula behind a coefficient is too: base
parameters of the same arm with other lengths give the coefficient as a function of them, and its dimension says which
products of lengths can occur. A formula counts only if it reproduces all of these arms with whole factors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement, permutations

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import DynidError
from drivers.core.validation import load_yaml
from ident.model.base_parameters import BaseParameters, base_parameters
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.parameters import StandardParameter

ARMS_BESIDE = 10
"""Arms more than a formula has unknown factors."""

EXACT = 1e-7
"""Relative deviation up to which a formula holds."""

_SPREAD = (0.6, 1.5)
_POWERS = {"M": 0, "MX": 1, "MY": 1, "MZ": 1}


@dataclass(frozen=True)
class _Product:
    """A product of lengths, as text and as a function of them."""

    text: str
    value: Callable[[dict[str, float]], float]


def symbolic_expressions(robot_file: RobotFile, model: DynamicModel, base: BaseParameters) -> tuple[str, ...]:
    """The expressions of all base parameters, in symbols where the robot file names its lengths, else as they are.

    A coefficient that is no integer combination of products of lengths remains a number.
    """
    lengths = robot_file.robot.model.lengths
    if not lengths or robot_file.robot.model.mdh is None:
        return base.expressions
    parameters = model.parameters
    products = {power: _products(tuple(lengths), power) for power in (0, 1, 2)}
    count = ARMS_BESIDE + max(map(len, products.values()))
    arms = list(_arms_with_other_lengths(robot_file, model, base, count))
    if len(arms) < count:
        return base.expressions
    tables = {
        power: np.array([[product.value(values) for product in of_power] for values, _ in arms])
        for power, of_power in products.items()
    }
    projections = np.array([projection for _, projection in arms])
    expressions = []
    for row, column in enumerate(base.columns):
        terms = [parameters[column].name]
        for other in np.flatnonzero(base.projection[row]):
            if other == column:
                continue
            power = _power(parameters[column]) - _power(parameters[other])
            text = None
            if power in products:
                text = _formula(projections[:, row, other], tables[power], products[power])
            sign, factor = text if text is not None else _number(float(base.projection[row, other]))
            terms.append(f"{sign} {factor}{parameters[other].name}")
        expressions.append(" ".join(terms))
    return tuple(expressions)


def _arms_with_other_lengths(
    robot_file: RobotFile, model: DynamicModel, base: BaseParameters, count: int
) -> list[tuple[dict[str, float], FloatArray]]:
    """Lengths and projections of arms that keep the same columns; fewer than `count` where some cannot be built."""
    content = load_yaml(robot_file.text)
    generator = np.random.default_rng(0)
    arms = []
    for _ in range(count):
        factors = generator.uniform(*_SPREAD, len(robot_file.robot.model.lengths))
        lengths = {
            name: float(value * factor)
            for (name, value), factor in zip(robot_file.robot.model.lengths.items(), factors, strict=True)
        }
        content["model"]["lengths"] = lengths
        try:
            other = build_model(robot_file.model_copy(update={"robot": Robot.model_validate(content)}))
            changed = base_parameters(replace(model, joints=other.joints, transmission=other.transmission))
        except DynidError:  # a loop whose sides are named in part only does not close with other lengths
            break
        if changed.columns == base.columns:
            arms.append((lengths, changed.projection))
    return arms


def _power(parameter: StandardParameter) -> int:
    """Power of length in a parameter's unit over kg."""
    return _POWERS.get(parameter.symbol, 2)


def _products(names: Sequence[str], power: int) -> list[_Product]:
    if power == 0:
        ratios = [
            _Product(f"{a}/{b}", lambda lengths, a=a, b=b: lengths[a] / lengths[b])  # type: ignore[misc]
            for a, b in permutations(names, 2)
        ]
        return [_Product("", lambda lengths: 1.0), *ratios]
    products = []
    for chosen in combinations_with_replacement(names, power):
        text = f"{chosen[0]}²" if len(chosen) == 2 and chosen[0] == chosen[1] else "·".join(chosen)
        products.append(
            _Product(
                text,
                lambda lengths, chosen=chosen: float(np.prod([lengths[name] for name in chosen])),  # type: ignore[misc]
            )
        )
    return products


def _formula(values: FloatArray, table: FloatArray, products: Sequence[_Product]) -> tuple[str, str] | None:
    """Sign and factor (with its ·) of the combination of products that gives these values (K,), if there is one."""
    size = float(np.max(np.abs(values)))
    factors = np.linalg.lstsq(table, values, rcond=None)[0]
    whole = np.round(factors)
    if size == 0.0 or np.max(np.abs(table @ whole - values)) > EXACT * size:
        return None
    chosen = [(int(factor), product.text) for factor, product in zip(whole, products, strict=True) if factor]
    sign = "-" if all(factor < 0 for factor, _ in chosen) else "+"
    if sign == "-":
        chosen = [(-factor, text) for factor, text in chosen]
    chosen.sort(key=lambda pair: pair[0] < 0)
    texts = [_term(abs(factor), text) for factor, text in chosen]
    if len(texts) == 1:
        return sign, "" if texts[0] == "1" else f"{texts[0]}·"
    joined = texts[0]
    for (factor, _), text in zip(chosen[1:], texts[1:], strict=True):
        joined += f" {'+' if factor > 0 else '-'} {text}"
    return sign, f"({joined})·"


def _term(factor: int, text: str) -> str:
    if not text:
        return str(factor)
    return text if factor == 1 else f"{factor}·{text}"


def _number(value: float) -> tuple[str, str]:
    size = f"{abs(value):.4g}"
    return "-" if value < 0 else "+", "" if size == "1" else f"{size}·"
