"""Friction that no simulator's file holds: what stands in its place is the nearest that it can hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.friction.terms import no_terms
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.result.models.exported_model import without_further_friction


def test_coulomb_and_viscous_friction_come_near_the_curve_of_the_further_terms(three_joint):
    plain = build_model(three_joint)
    truth = {
        parameter.name: value for parameter, value in zip(plain.parameters, truth_vector(three_joint), strict=True)
    }
    terms = no_terms(3).with_shape("exponent", 0, 0.5)
    terms = terms.with_kinds(1, ["stribeck"]).with_shape("stribeck_velocity", 1, 0.2)
    model = replace(plain, terms=terms, presliding=(("Fs3", 1e-3),))
    values = np.array([truth.get(parameter.name, 1.5) for parameter in model.parameters])
    simple, kept, lacking = without_further_friction(model, values)
    found = {parameter.name: value for parameter, value in zip(simple.parameters, kept, strict=True)}
    assert simple.terms.plain
    assert not simple.presliding
    unchanged = truth.keys() - {"Fs1", "Fv1", "Fs2", "Fv2"}
    assert all(found[name] == truth[name] for name in unchanged)
    speed = np.linspace(0.05, 1.0, 40) * model.limits[0].velocity
    curve = truth["Fs1"] + truth["Fv1"] * np.sqrt(speed)
    assert found["Fs1"] + found["Fv1"] * speed == pytest.approx(curve, abs=0.15 * np.ptp(curve))
    assert found["Fv2"] < truth["Fv2"]  # the Stribeck term falls with the speed
    text = "; ".join(lacking)
    assert "Stribeck friction of" in text
    assert "presliding of Fs3" in text
