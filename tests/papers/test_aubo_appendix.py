"""The 36 inertial expressions of the AUBO paper's appendix (eq. 22-72) against the numerical base parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from daq.robot.loader import load_robot
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model

SYMBOLS = {
    "Ixx": "XX",
    "Ixy": "XY",
    "Ixz": "XZ",
    "Iyy": "YY",
    "Iyz": "YZ",
    "Izz": "ZZ",
    "Sx": "MX",
    "Sy": "MY",
    "Sz": "MZ",
    "m": "M",
}


@pytest.fixture(scope="module")
def aubo():
    """Names of the standard parameters, an orthonormal basis of the identifiable space, and the lengths of Table I."""
    robot_file = load_robot("aubo_i5")
    model = build_model(robot_file)
    off = (False,) * 6
    model = replace(model, motor_inertia=off, viscous=off, coulomb=off, offset=off)
    base = base_parameters(model)
    basis = np.linalg.qr(base.projection.T)[0]
    rows = robot_file.robot.model.mdh
    lengths = {"a3": rows[2].d, "a4": rows[3].d, "d2": rows[1].r, "d5": rows[4].r, "d6": rows[5].r}
    return [parameter.name for parameter in model.parameters], basis, lengths


def combination(names, *terms):
    vector = np.zeros(len(names))
    for coefficient, symbol, links in terms:
        for link in links:
            vector[names.index(f"{SYMBOLS[symbol]}{link}")] += coefficient
    return vector


def expressions(lengths, *, corrected):
    """Number in the paper → terms (coefficient, symbol, links)."""
    a3, a4, d2, d5, d6 = (lengths[name] for name in ("a3", "a4", "d2", "d5", "d6"))
    on3 = -2 * d2 if corrected else 2 * d2  # axis 3 is flipped by alpha = pi
    square5, square6 = (d5**2, d6**2) if corrected else (d5, d6)
    e = {
        1: [(a3**2, "m", (3, 4, 5, 6)), (d2**2, "m", (2, 3, 4, 5, 6)), (a4**2, "m", (4, 5, 6)), (2 * d2, "Sz", (2, 4)),
            (on3, "Sz", (3,)), (1, "Iyy", (2, 3, 4)), (1, "Izz", (1,))],
        5: [(-(a3**2), "m", (3, 4, 5, 6)), (1, "Ixx", (2,)), (-1, "Iyy", (2,))],
        6: [(1, "Ixy", (2,))],
        7: [(a3, "Sz", (3,)), (-a3, "Sz", (4,)), (1, "Ixz", (2,))],
        8: [(1, "Iyz", (2,))],
        9: [(a3**2, "m", (3, 4, 5, 6)), (1, "Izz", (2,))],
        10: [(a3, "m", (3, 4, 5, 6)), (1, "Sx", (2,))],
        11: [(1, "Sy", (2,))],
        15: [(-(a4**2), "m", (4, 5, 6)), (1, "Ixx", (3,)), (-1, "Iyy", (3,))],
        16: [(1, "Ixy", (3,))],
        17: [(a4, "Sz", (4,)), (1, "Ixz", (3,))],
        18: [(1, "Iyz", (3,))],
        19: [(a4**2, "m", (4, 5, 6)), (1, "Izz", (3,))],
        20: [(a4, "m", (4, 5, 6)), (1, "Sx", (3,))],
        21: [(1, "Sy", (3,))],
        25: [(square5, "m", (5, 6)), (2 * d5, "Sz", (5,)), (1, "Ixx", (4,)), (-1, "Iyy", (4,)), (1, "Iyy", (5,))],
        26: [(1, "Ixy", (4,))],
        27: [(1, "Ixz", (4,))],
        28: [(1, "Iyz", (4,))],
        29: [(d5**2, "m", (5, 6)), (2 * d5, "Sz", (5,)), (1, "Izz", (4,)), (1, "Iyy", (5,))],
        30: [(1, "Sx", (4,))],
        31: [(d5, "m", (5, 6)), (1, "Sy", (4,)), (1, "Sz", (5,))],
        35: [(square6, "m", (6,)), (2 * d6, "Sz", (6,)), (1, "Ixx", (5,)), (-1, "Iyy", (5,)), (1, "Iyy", (6,))],
        36: [(1, "Ixy", (5,))],
        37: [(1, "Ixz", (5,))],
        38: [(1, "Iyz", (5,))],
        39: [(d6**2, "m", (6,)), (2 * d6, "Sz", (6,)), (1, "Izz", (5,)), (1, "Iyy", (6,))],
        40: [(1, "Sx", (5,))],
        41: [(-d6, "m", (6,)), (-1, "Sz", (6,)), (1, "Sy", (5,))],
        45: [(1, "Ixx", (6,)), (-1, "Iyy", (6,))],
        46: [(1, "Ixy", (6,))],
        47: [(1, "Ixz", (6,))],
        48: [(1, "Iyz", (6,))],
        49: [(1, "Izz", (6,))],
        50: [(1, "Sx", (6,))],
        51: [(1, "Sy", (6,))],
    }  # fmt: skip
    assert len(e) == 36
    return e


def outside(vector, basis):
    """Part of a combination, relative to its length, that no motion can reveal."""
    return np.linalg.norm(vector - basis @ (basis.T @ vector)) / np.linalg.norm(vector)


def test_all_36_corrected_expressions_are_identifiable(aubo):
    names, basis, lengths = aubo
    assert basis.shape[1] == 36
    for number, terms in expressions(lengths, corrected=True).items():
        assert outside(combination(names, *terms), basis) < 1e-9, f"theta {number}"


def test_printed_expressions_fail_exactly_where_they_are_misprinted(aubo):
    names, basis, lengths = aubo
    printed = expressions(lengths, corrected=False)
    wrong = [number for number, terms in printed.items() if outside(combination(names, *terms), basis) > 1e-3]
    assert wrong == [1, 25, 35]


def test_corrected_expressions_span_the_identifiable_space(aubo):
    names, _, lengths = aubo
    stacked = np.array([combination(names, *terms) for terms in expressions(lengths, corrected=True).values()])
    assert np.linalg.matrix_rank(stacked) == 36
