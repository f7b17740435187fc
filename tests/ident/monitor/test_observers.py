"""External torque: exact discretisation, any division into batches, known wrenches, gaps and samples that are none."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from monitored_arm import PERIOD, exact_samples, known_model
from scipy.linalg import expm

from ident.model.dynamics.link_jacobian import LinkJacobians
from ident.model.true_parameters import truth_vector
from ident.monitor.choices import Kind
from ident.monitor.interval_torque import Intervals, IntervalTorque, JointSamples, joined
from ident.monitor.observers import observer

KINDS: tuple[Kind, ...] = ("momentum", "direct", "kalman")


@each("kind", KINDS)
@each("bandwidth", [20.0, 50.0])
def test_a_constant_torque_is_reached_as_the_differential_equation_says(kind: Kind, bandwidth: float) -> None:
    steps = np.array([0.0, 5.0, 5.0, -3.0, 1.0]).repeat(100)[:, None]
    noises = (np.array([0.0]), np.array([1.0]))
    found = observer(kind, PERIOD, 1, bandwidth, *noises).apply(steps, np.zeros(len(steps), dtype=bool))[:, 0]
    rate = 2.0 * bandwidth if kind == "direct" else bandwidth
    chain = np.array([[-rate, 0.0, rate], [rate, -rate, 0.0], [0.0, 0.0, 0.0]])  # two stages, and what drives them
    over_a_period, state, exact = expm(chain * PERIOD), np.zeros(2), []
    for drive in steps[:, 0]:
        state = (over_a_period @ [*state, drive])[:2]
        exact.append(state[1 if kind == "direct" else 0])
    if kind != "kalman":
        assert found == pytest.approx(np.array(exact), abs=1e-12)
    assert found[99::100] == pytest.approx(steps[99::100, 0], abs=0.2)


@pytest.mark.parametrize("robot", ["ur5e", "sr400", "panda"])
@pytest.mark.parametrize("momentum", [True, False])
def test_without_contact_little_is_left_and_a_wrench_is_recovered(robot: str, momentum: bool) -> None:
    model, _ = known_model(robot)
    free = exact_samples(robot)
    rest = IntervalTorque(model, PERIOD, momentum=momentum).add(free)
    slow = np.abs(rest.velocity) < 0.05
    size = np.abs(free.torque).max(axis=0)
    assert np.all(np.where(slow, 0.0, np.abs(rest.external)).max(axis=0) < 2e-3 * size)
    places, force = LinkJacobians(model.dynamics.model), np.array([20.0, -30.0, 10.0, 1.0, 2.0, -3.0])
    pushes = []
    for position in free.position:
        places.move(position)
        pushes.append(places.jacobian(model.dynamics.model.tool_link, np.array([0.0, 0.02, 0.05])).T @ force)
    pushed = IntervalTorque(model, PERIOD, momentum=momentum).add(
        JointSamples(free.time, free.position, free.torque - np.array(pushes))
    )
    expected = np.array(pushes)[1:-1]
    assert pushed.external - rest.external == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


@settings(max_examples=8)
@given(cuts=st.lists(st.integers(0, 200), max_size=8), kind=st.sampled_from(KINDS), gap=st.booleans())
def test_batches_may_be_divided_in_any_way(cuts: list[int], kind: Kind, gap: bool) -> None:
    model, _ = known_model("ur5e")
    samples = exact_samples("ur5e", 200)
    if gap:
        late = samples.time + np.where(np.arange(200) > 90, 0.05, 0.0)
        samples = JointSamples(late, samples.position, samples.torque)

    def watched(edges: list[int]) -> tuple[Intervals, np.ndarray]:
        source, filtering = IntervalTorque(model, PERIOD), observer(kind, PERIOD, 6, 50.0, np.ones(6), np.ones(6))
        parts, rows = [], []
        for start, stop in pairwise(edges):
            at = slice(start, stop)
            part = source.add(JointSamples(samples.time[at], samples.position[at], samples.torque[at]))
            parts.append(part)
            rows.append(filtering.apply(part.external, part.restarted))
        return joined(parts), np.concatenate(rows)

    whole, filtered = watched([0, 200])
    parts, stepped = watched([0, *sorted(cuts), 200])
    assert np.array_equal(parts.time, whole.time)
    assert np.array_equal(parts.restarted, whole.restarted)
    assert parts.external == pytest.approx(whole.external, abs=1e-12 * np.abs(whole.measured).max())
    assert stepped == pytest.approx(filtered, abs=1e-12 * np.abs(whole.measured).max())
    assert np.count_nonzero(whole.restarted) == 1 + gap


def test_samples_that_are_none_are_left_out_and_a_clock_that_was_set_back_is_a_gap() -> None:
    model, _ = known_model("ur5e")
    samples = exact_samples("ur5e", 60)
    torque, time = samples.torque.copy(), samples.time.copy()
    torque[20] = np.nan
    time[40:] -= 100.0
    found = IntervalTorque(model, PERIOD).add(JointSamples(time, samples.position, torque))
    assert np.isfinite(found.external).all()
    assert np.count_nonzero(found.restarted) == 2
    assert len(found) == 40 - 1 - 2 + 20 - 2
    nothing = IntervalTorque(model, PERIOD).add(JointSamples(time, samples.position, np.full_like(torque, np.nan)))
    assert len(nothing) == 0


def test_truth_is_the_model_of_these_tests() -> None:
    model, file = known_model("ur5e")
    assert model.dynamics.base.projection @ truth_vector(file) == pytest.approx(model.dynamics.parameters)
