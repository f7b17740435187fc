"""Drive gains from a free and a loaded run of a simulated arm whose true gains are hidden."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from loaded_arm import HIDDEN, LOAD, arm_runs, runs

from daq.motion.trajectories import FourierSeries
from daq.recording.recording import Channel
from daq.robot.loader import load_robot, parse_robot
from drivers.core.errors import DataError
from ident.experiments.gains.drive_gains import drives_text, identify_gains, left_out_gains
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.load import KnownLoad
from ident.model.true_parameters import truth_vector
from sim_drivers.plant.altered_arm import with_load
from sim_drivers.synthetic.measurement import simulate_recording
from studies.synthetic.altered_arms import with_gains

SEEDS = range(4)
TRUE = np.array([load_robot("ur10e").robot.drive(name).gain * factor for name, factor in HIDDEN.items()])


@pytest.fixture(scope="module")
def found():
    return [identify_gains(*runs(seed, hidden=True), KnownLoad(2.8)) for seed in SEEDS]


def column(gains, field: str) -> np.ndarray:
    """Base parameters, or their standard deviations; nan where there is none."""
    return np.array([getattr(row, field) for row in gains.base_parameters], dtype=float)


def test_the_hidden_gains_are_found(found):
    errors = np.array([each.values / TRUE - 1 for each in found])
    assert np.all(np.abs(errors[:, :5]) < 0.04)
    assert np.all(np.abs(errors[:, 5]) < 0.12)  # the last wrist carries little


def test_they_lie_within_their_error_bars(found):
    errors = np.array([(each.values - TRUE) / each.std for each in found])
    assert np.mean(np.abs(errors) < 2) > 0.75
    assert np.max(np.abs(errors)) < 4.5


def test_parameters_carry_the_gains_deviations(found):
    base = base_parameters(build_model(load_robot("ur10e")))
    truth = base.projection @ truth_vector(load_robot("ur10e"))
    errors = np.array([(column(each, "value") - truth) / column(each, "std") for each in found])
    assert np.mean(np.abs(errors) < 2) > 0.88
    # Friction is seen in the current itself: its relative deviation is at least nearly that of the gain.
    viscous = base.names.index("Fv1")
    for each in found:
        row = each.base_parameters[viscous]
        relative = row.std / abs(row.value)
        assert relative > 0.7 * each.gains[0].std / abs(each.gains[0].gain)


def test_a_heavier_truth_gives_larger_gains():
    """The known mass alone fixes the size: half of it, half the gains."""
    whole = identify_gains(*runs(0, hidden=True), KnownLoad(2.8))
    half = identify_gains(*runs(0, hidden=True), KnownLoad(1.4))
    assert half.values == pytest.approx(0.5 * whole.values, rel=1e-3)


def test_knowing_more_of_the_load_helps(found):
    more = identify_gains(*runs(0, hidden=True), LOAD)
    assert more.load == []
    assert np.mean(more.std / found[0].std) < 1.0
    assert np.all(np.abs(more.values / TRUE - 1)[:5] < 0.04)


def test_unknown_and_negative_gains(three_joint):
    load = KnownLoad(1.5, (0.05, 0.02, 0.04), (0.004, 0.0, 0.0, 0.004, 0.0, 0.003))
    free, loaded = arm_runs(three_joint, {"j1": 1.2, "j2": 0.8}, load, 3)
    text = three_joint.text
    for name, gain in (("j1", "10"), ("j2", "-8"), ("j3", "4")):
        text = text.replace(
            f"{{joint: {name}, gain: {gain}, gain_std: 0.{'2' if name == 'j3' else '5'}}}", f"{{joint: {name}}}"
        )
    unknown = parse_robot(text, where="unknown", folder=None)
    assert all(drive.gain is None for drive in unknown.robot.drives)
    each = identify_gains(free, loaded, load, unknown)
    assert each.values == pytest.approx([12.0, -6.4, 4.0], rel=0.1)
    assert all(gain.file_gain is None for gain in each.gains)


def test_what_cannot_be_told_is_said(found):
    """The last wrist of a UR10e carries little but itself; a load on its axis does not help it."""
    on_axis = KnownLoad(0.3, (0.0, 0.0, 0.05), (0.0003, 0.0, 0.0, 0.0003, 0.0, 0.0003))
    free, loaded = arm_runs(load_robot("ur10e"), HIDDEN, on_axis, 0)
    each = identify_gains(free, loaded, KnownLoad(0.3))
    assert np.isnan(each.gains[5].gain)
    assert each.gains[5].rsd_percent == np.inf
    assert any("the gain of wrist_3_joint is" in warning for warning in each.warnings)
    assert all(0 <= gain.angle_degrees <= 90 for gain in each.gains)
    # What the others show is not spoilt by it.
    errors = (each.values[:5] - TRUE[:5]) / each.std[:5]
    assert np.max(np.abs(errors)) < 4.5
    assert each.values[:3] == pytest.approx(TRUE[:3], rel=0.1)
    assert "joint: wrist_3_joint, gain: 11.47, gain_std: 1.1" in each.robot_file_text
    unsure = [gain.model_copy(update={"std": 0.6 * abs(gain.gain)}) for gain in each.gains]
    assert f"gain: {each.gains[0].gain:.5g}" in each.robot_file_text
    assert f"gain: {each.gains[0].gain:.5g}" not in drives_text(load_robot("ur10e").robot, each.signal, unsure)
    assert len(left_out_gains(unsure)) == 5


def test_slow_motions_tell_the_gains_that_gravity_acts_on():
    sine, cosine = np.zeros((2, 6, 5))
    for joint, harmonic in enumerate((0, 1, 2, 4, 3, 4)):
        sine[joint, harmonic] = 0.3 if joint == 0 else 1.0
    sine[1:, 0], cosine[1:, 3] = 0.2, 0.2
    middle = np.array([0.0, -1.2, 0.8, -0.5, 0.7, 0.3])
    motion = FourierSeries.from_position_amplitudes(300.0, middle, sine, cosine)
    assert np.max(np.abs(motion.evaluate(np.linspace(0.0, 300.0, 3000))[1])) < 0.15
    arm = with_gains(load_robot("ur10e"), HIDDEN)
    free = simulate_recording(arm, motion, 300.0, seed=1, rate=20.0)
    loaded = simulate_recording(with_load(arm, LOAD.mass, LOAD.com, LOAD.inertia), motion, 300.0, seed=2, rate=20.0)
    each = identify_gains(free, loaded, KnownLoad(2.8))
    assert np.isnan(each.values[0])  # gravity does not act on a vertical axis
    assert any("the gain of shoulder_pan_joint is" in warning for warning in each.warnings)
    assert each.values[1:5] == pytest.approx(TRUE[1:5], rel=0.02)
    assert np.max(np.abs((each.values - TRUE) / each.std)[1:5]) < 4.5


def test_a_torque_recording_is_refused():
    free, loaded = runs(0)
    stream = loaded.streams["joints"]
    current = stream.channels["current"]
    channels = {"position": stream.channels["position"]}
    channels["torque"] = Channel("torque", current.values, "N*m", current.columns, "no current")
    without = replace(loaded, streams={"joints": replace(stream, channels=channels)})
    with pytest.raises(DataError, match="records no motor current") as refused:
        identify_gains(free, without, KnownLoad(2.8))
    assert refused.value.exit_status == 2


def test_drives_that_give_torque_are_refused():
    free, loaded = runs(0)
    text = free.robot_text.replace("signal: current", "signal: torque")
    with pytest.raises(DataError, match="signal is torque"):
        identify_gains(free, loaded, KnownLoad(2.8), parse_robot(text, where="torque", folder=None))


def test_different_arms_are_refused():
    free, loaded = runs(0)
    other = loaded.robot_text.replace("name: ur10e", "name: another")
    with pytest.raises(DataError, match="is of another, not of ur10e"):
        identify_gains(free, replace(loaded, robot_text=other), KnownLoad(2.8))


def test_the_text_for_the_robot_file_is_valid(found):
    text = load_robot("ur10e").text
    start, stop = text.index("drives:  #"), text.index("friction: {model")
    robot = parse_robot(text[:start] + found[0].robot_file_text + "\n\n" + text[stop:], where="new", folder=None).robot
    assert [drive.gain for drive in robot.drives] == pytest.approx(found[0].values, rel=1e-4)
    assert [drive.gain_std for drive in robot.drives] == pytest.approx(found[0].std, rel=0.05)


def test_the_object_is_complete(found):
    content = found[0].model_dump()
    assert [gain["joint"] for gain in content["gains"]] == list(HIDDEN)
    assert len(content["base_parameters"]) == base_parameters(build_model(load_robot("ur10e"))).count
    assert content["gap"] > 1
