from __future__ import annotations

import numpy as np
import pytest
from each import each

from ident.estimators.swarm.particle_swarm import ConstantWeight, ParticleSwarm, RandomWeight, particle_stability


@each("weight", [-0.5, 0.0, 0.4, 0.7298, 0.9])
def test_the_variance_is_stable_up_to_polis_bound(weight: float) -> None:
    bound = 24.0 * (1.0 - weight**2) / (7.0 - 5.0 * weight)
    inside, outside = (particle_stability(ConstantWeight(weight), *[0.5 * f * bound] * 2) for f in (0.999, 1.001))
    assert inside.mean < 1.0
    assert inside.variance < 1.0 < outside.variance
    assert not inside.remark
    assert "variance grows" in outside.remark


@pytest.mark.parametrize(
    ("weight", "cognitive", "social"), [(RandomWeight(), 1.0, 1.2), (RandomWeight(0.4, 0.9, 0.3), 1.5, 3.0)]
)
def test_the_radius_is_the_growth_of_simulated_particles(weight: RandomWeight, cognitive: float, social: float) -> None:
    generator = np.random.default_rng(7)
    x = np.stack([np.ones(400_000), np.zeros(400_000)])
    squares = []
    for _ in range(12):
        w = weight.draw(generator, x.shape[1])[:, 0]
        theta = cognitive * generator.random(x.shape[1]) + social * generator.random(x.shape[1])
        x = np.stack([(1 + w - theta) * x[0] - w * x[1], x[0]])
        squares.append(np.mean(x[0] ** 2))
    growth = (squares[-1] / squares[5]) ** (1 / 6)
    assert particle_stability(weight, cognitive, social).variance == pytest.approx(growth, rel=0.05)


def test_the_papers_settings_are_said_to_be_unstable() -> None:
    paper = ParticleSwarm(weight=ConstantWeight(1.3), cognitive=1.5, social=3.0)
    assert paper.stability.mean == pytest.approx(1.3**0.5)
    (remark,) = paper.remarks
    assert remark.startswith("W = 1.3, c1 = 1.5, c2 = 3: the mean position grows 1.14-fold")
    assert ParticleSwarm().remarks == ()
