"""Sensitivities of a simulated motion are those of two simulations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.estimators.methods.output_error import OutputRows
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.true_parameters import truth_vector
from ident.simulation.tracking import tracked


def test_sensitivities_are_differences_of_simulations(three_joint, smooth_segment):
    """Without dry friction, whose direction the sensitivities hold; the controller's gains are those of each model."""
    model = replace(build_model(three_joint), coulomb=(False,) * 3)
    base = base_parameters(model)
    standard = truth_vector(three_joint)
    names = [parameter.name for parameter in build_model(three_joint).parameters]
    standard = standard[[names.index(parameter.name) for parameter in model.parameters]]
    truth = base.projection @ standard
    segment = smooth_segment(model, 400, parameters=standard)
    inverse = InverseDynamics(model, base, truth)
    rows = OutputRows(inverse, segment, tracked(inverse, segment), every=10)
    found = {part.motor: part.regressor for part in rows if part.samples[0] == 0}
    at = rows.series()
    assert np.max(np.abs(at.residual)) < 2e-3
    for name in ("Fv1", "Fo2", "MX3"):
        column = base.names.index(name)
        change = 1e-3 * max(1.0, abs(truth[column]))
        moved = truth.copy()
        moved[column] += change
        other = InverseDynamics(model, base, moved)
        departed = (tracked(other, segment).motion.position - rows.tracking.motion.position)[::10] / change
        for motor in range(3):
            expected = departed[:, motor]
            scale = np.max(np.abs(departed))
            assert found[motor][column] == pytest.approx(expected[: found[motor].shape[1]], abs=0.05 * scale)
