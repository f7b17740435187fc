"""Pseudo-inertias of bodies made of mass points, which can all exist."""

from __future__ import annotations

import numpy as np
import pytest
from each import each

from drivers.core.errors import ModelError
from ident.estimators.feasible.pseudo_inertia import body_of, pseudo_inertia, standard_parameters
from ident.model.parameters import link_parameters


def point_body(seed: int, count: int = 6) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    return generator.uniform(0.1, 2.0, count), generator.normal(size=(count, 3))


@each("seed", range(5))
def test_the_pseudo_inertia_is_the_second_moment_of_the_mass(seed: int) -> None:
    masses, points = point_body(seed)
    homogeneous = np.column_stack([points, np.ones(len(masses))])
    expected = homogeneous.T @ (masses[:, None] * homogeneous)
    link = standard_parameters(expected)
    np.testing.assert_allclose(pseudo_inertia(link), expected, rtol=1e-12, atol=1e-12)
    inertia = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, points, strict=True))
    np.testing.assert_allclose(link[:6], inertia[np.triu_indices(3)], rtol=1e-12, atol=1e-12)


@each("seed", range(5))
def test_a_body_has_its_link_s_parameters(seed: int) -> None:
    masses, points = point_body(seed)
    homogeneous = np.column_stack([points, np.ones(len(masses))])
    link = standard_parameters(homogeneous.T @ (masses[:, None] * homogeneous))
    body = body_of(link)
    np.testing.assert_allclose(body.com, masses @ points / masses.sum(), rtol=1e-12)
    xx, xy, xz, yy, yz, zz = body.inertia.values()
    again = link_parameters(body.mass, tuple(body.com), (xx, xy, xz, yy, yz, zz))
    np.testing.assert_allclose(again, link, rtol=1e-10, atol=1e-10)
    for mass in (0.0, -1.0, np.nan):
        with pytest.raises(ModelError, match=rf"a link of {mass:g} kg has no centre of mass"):
            body_of(np.array([*link[:-1], mass]))


def test_it_is_definite_exactly_where_the_triangle_inequalities_hold() -> None:
    for principal, possible in (((1.0, 1.0, 1.9), True), ((1.0, 1.0, 2.1), False), ((-0.1, 1.0, 1.0), False)):
        a, b, c = principal
        link = link_parameters(2.0, (0.3, -0.2, 0.5), (a, 0.0, 0.0, b, 0.0, c))
        assert (np.linalg.eigvalsh(pseudo_inertia(link))[0] > 0) == possible
