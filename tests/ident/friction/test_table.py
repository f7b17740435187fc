"""Every friction term: slopes, derivatives by the shape, what it does at rest, its C code, and how to ask for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from each import each

from daq.robot.schema import Friction
from drivers.core.errors import RobotFileError
from ident.export.c_code.expressions import Graph
from ident.export.c_code.joint_terms import EXPRESSIONS
from ident.friction.choice import check_friction, chosen_friction
from ident.friction.table import OPTIONS, TERM, TERMS, Operands, Term
from ident.friction.terms import friction_terms, no_terms

WIDTH = 0.1
"""Width of the smoothed sign [rad/s]."""


def operands(term: Term, speed: np.ndarray, shape: float | None = None) -> Operands:
    """Motion with a smoothed sign, a load and a temperature, at a shape inside its range."""
    middle = 1.0 if term.shape is None else term.shape.grid[len(term.shape.grid) // 2]
    direction = np.tanh(speed / WIDTH)
    slope = (1.0 - direction**2) / WIDTH
    shape = middle if shape is None else shape
    return Operands(
        speed,
        direction,
        shape,
        np.full_like(speed, 3.0),
        np.full_like(speed, 310.0),
        direction_slope=slope,
        angle=np.full_like(speed, 0.4),
    )


def speeds() -> np.ndarray:
    speed = np.random.default_rng(3).uniform(0.02, 2.0, 60)
    return speed * np.where(np.arange(60) % 2, 1.0, -1.0)


@each("term", TERMS)
def test_slopes_are_derivatives_by_the_velocity(term):
    speed, step = speeds(), 1e-6
    up, down = (term.signal(operands(term, speed + sign * step)) for sign in (1.0, -1.0))
    expected = np.broadcast_to((np.asarray(up) - down) / (2 * step), speed.shape)
    assert np.allclose(expected, term.slope(operands(term, speed)), atol=1e-6)


@pytest.mark.parametrize("term", [term for term in TERMS if term.shape is not None and term.shape.derivative])
def test_sensitivities_are_derivatives_by_the_shape(term):
    speed, step, at = speeds(), 1e-6, operands(term, speeds())
    derivative = term.shape.derivative
    up, down = (term.signal(replace(at, shape=at.shape + sign * step)) for sign in (1.0, -1.0))
    assert np.allclose((up - down) / (2 * step), derivative.signal(at), atol=1e-6)
    up, down = (derivative.signal(operands(term, speed + sign * step)) for sign in (1.0, -1.0))
    assert np.allclose((up - down) / (2 * step), derivative.slope(at), atol=1e-5)


@each("term", TERMS)
def test_only_dry_friction_acts_at_rest_and_all_friction_changes_sign(term):
    speed = np.array([1e-12, 1.0])
    forth, back = (
        np.broadcast_to(
            term.signal(Operands(sign * speed, sign, 1.0, np.ones(2), np.full(2, 310.0), angle=np.ones(2))), (2,)
        )
        for sign in (1.0, -1.0)
    )
    if not term.rubs:
        assert np.all(forth == back)
    else:
        assert np.allclose(forth, -back, rtol=1e-12)
        assert (abs(forth[0]) > 0.5) == term.dry


@each("term", [term for term in TERMS if term.needs != "temperature"])
def test_expressions_of_c_code_are_the_same(term):
    graph, at = Graph(), operands(term, speeds())
    at = replace(at, direction=np.sign(at.rate))
    rate, load, angle, one = *(graph.symbol(name) for name in ("rate", "load", "angle")), graph.constant(1.0)
    written = term.signal(Operands(rate, EXPRESSIONS.sign(rate), at.shape, load, maths=EXPRESSIONS, angle=angle))
    found = graph.evaluate([one * written], {"rate": at.rate, "load": at.load, "angle": at.angle})[0]
    assert np.allclose(found, term.signal(at), rtol=1e-12, atol=0)


@each("option", OPTIONS)
def test_what_a_user_asks_for_is_what_the_motors_get(option):
    check_friction(f"coulomb-viscous+{option.word}")
    by_text = friction_terms(chosen_friction(Friction(), f"coulomb-viscous+{option.word}"), ("j1", "j2"))
    by_file = friction_terms(Friction(model="coulomb-viscous", terms=(option.word,)), ("j1", "j2"))
    assert by_text == by_file == no_terms(2).with_option(option, 0).with_option(option, 1)
    assert [by_text.option(option.group, motor) for motor in range(2)] == [option, option]
    shape = TERM[option.kinds[0]].shape
    assert by_text.shaped == (shape is not None and option.shape is None)


def test_a_word_that_is_none_is_refused():
    with pytest.raises(RobotFileError, match="no friction term is called 'sticky'"):
        friction_terms(Friction(model="coulomb-viscous", terms=("sticky",)), ("j1",))
