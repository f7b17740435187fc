"""Two models side by side."""

from __future__ import annotations

import numpy as np
import pytest
from true_results import true_result

import dynid
from daq.robot.loader import load_robot

pytestmark = pytest.mark.usefixtures("mistakes_not_sought", "not_simulated", "stated_friction")


@pytest.fixture(scope="module")
def models() -> list[dynid.IdentificationResult]:
    """Three identifications of one small arm: two of other recordings, and one with other friction."""
    runs = [dynid.simulate("up6", duration=20.0, seed=seed, rate=100.0) for seed in (1, 2)]
    heavy = dynid.simulate("up6", duration=20.0, seed=3, rate=100.0)
    velocity = np.gradient(heavy.streams["joints"].channels["position"].values[:, 1], 0.01)
    heavy.streams["joints"].channels["torque"].values[:, 1] += 0.5 * velocity
    return [dynid.identify(run, friction="coulomb-viscous", presliding=False) for run in (*runs, heavy)]


def test_a_model_does_not_differ_from_itself(models):
    same = dynid.diff(models[0], models[0])
    assert np.all(same.parameters["difference"] == 0.0)
    assert same.agree
    assert same.test.statistic == 0.0
    assert len(same.shared) == 1
    assert "not independent" in same.headline


def test_models_of_one_arm_agree_and_another_friction_does_not(models):
    agreeing = dynid.diff(models[0], models[1])
    assert agreeing.agree
    assert agreeing.shared == ()
    assert np.mean(np.abs(agreeing.parameters["z"]) < 1.96) > 0.8
    differing = dynid.diff(models[0], models[2])
    assert not differing.agree
    friction = differing.parameters.row("Fv2")
    assert friction["difference"] == pytest.approx(0.5, rel=0.2)
    assert friction["z"] > 5
    assert "differ significantly" in str(differing)


def test_the_other_way_round_the_signs_change(models):
    there, back = dynid.diff(models[0], models[1]), dynid.diff(models[1], models[0])
    np.testing.assert_array_equal(there.parameters["z"], -back.parameters["z"])
    assert there.test.statistic == pytest.approx(back.test.statistic, rel=1e-6)


def test_errors_purposes_and_checks_are_those_of_the_models(models):
    difference = dynid.diff(models[0], models[2])
    one, other = (model.delivered.validation_all_samples for model in (models[0], models[2]))
    np.testing.assert_array_equal(difference.errors["first_rmse"][:-1], one.rmse)
    assert difference.errors.row("all")["second"] == 100.0 * other.relative_error
    assert len(difference.purposes) == 4
    raised = {check.name for model in (models[0], models[2]) for check in model.verdict.checks}
    assert set(difference.checks.names) == raised
    assert "<table>" in difference._repr_html_()


def test_the_covariances_weigh_the_differences():
    robot = load_robot("up6")
    names = [parameter.name for parameter in true_result(robot).base_parameters]
    generator = np.random.default_rng(0)
    roots = [generator.normal(size=(len(names), len(names))) + 3.0 * np.eye(len(names)) for _ in range(2)]
    covariances = [root @ root.T for root in roots]
    values = {parameter.name: parameter.value for parameter in true_result(robot).base_parameters}
    moved = {
        name: value + step
        for (name, value), step in zip(values.items(), generator.normal(size=len(names)), strict=True)
    }
    models = [
        dynid.IdentificationResult(true_result(robot, changed, covariance))
        for changed, covariance in zip((values, moved), covariances, strict=True)
    ]
    delta = np.array([moved[name] - values[name] for name in names])
    expected = delta @ np.linalg.solve(covariances[0] + covariances[1], delta)
    difference = dynid.diff(*models)
    assert difference.test.statistic == pytest.approx(expected, rel=1e-6)
    assert difference.test.freedom == len(names)
    lacking = dynid.diff(models[0], dynid.IdentificationResult(true_result(robot)))
    assert lacking.test is None
    assert lacking.agree is None
    assert "cannot be tested" in lacking.headline


def test_models_that_cannot_be_compared_are_refused_in_one_line(models):
    other = dynid.IdentificationResult(true_result(load_robot("ur5e")))
    with pytest.raises(dynid.UsageError, match="different robots: up6 and ur5e"):
        dynid.diff(models[0], other)
    run = dynid.simulate("up6", duration=5.0, seed=1, rate=100.0)
    with pytest.raises(dynid.UsageError, match=r"different base parameters \(F"):
        dynid.diff(models[0], dynid.identify(run, friction="viscous", presliding=False))
    renamed = models[0].result.model_copy(update={"joints": ["a", "b", "c"]})
    with pytest.raises(dynid.UsageError, match="different joints"):
        dynid.diff(models[0], dynid.IdentificationResult(renamed))
    with pytest.raises(dynid.ResultFileError, match="no such file"):
        dynid.diff(models[0], "nowhere")
