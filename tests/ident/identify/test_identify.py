"""The whole way from recordings to a validated model, on simulated arms whose truth is known."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from true_results import truth_of

from daq.recording.recording import JOINTS_STREAM
from daq.robot.loader import load_robot, parse_robot
from drivers.core.errors import DataError, IdentificationError, RecordingError, UsageError
from ident.assessment.validation import HELD_OUT_SHARE
from ident.identify.data_split import split_data
from ident.identify.identification import IdentifyChoices, ModelChoices
from ident.identify.identify import apply_model_choices, identify
from ident.identify.preparation import prepare_data
from ident.identify.revalidate import stored_choices
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.regressor import RegressorKernel
from ident.regression import least_squares
from ident.regression.velocity_reversals import STICKING_SHARE
from ident.result.schema import Result
from ident.signals.pipeline import PreprocessChoices
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.synthetic.data_mistakes import with_rows, with_values

STATED = IdentifyChoices(search_delay=False, presliding=False, model=ModelChoices(friction="coulomb-viscous"))
"""The terms that the arm has, and no search: a third of the time of an identification without its checks."""
alone = pytest.mark.usefixtures("estimate_alone")


@alone
@pytest.mark.parametrize(
    ("rate", "choices"),
    [
        (200.0, IdentifyChoices()),
        (200.0, replace(STATED, method="ols", search_delay=True)),
        (1000.0, replace(STATED, search_delay=True)),
    ],
)
def test_the_truth_comes_back_from_perfect_sensors(noise_free, rate, choices):
    """To 1e-3; what limits it is the central difference at 200 Hz (ω²/6 of a period squared) and, at 1000 Hz, the
    low-pass of the positions."""
    motion = random_fourier_motion(build_model(noise_free), 10.0, seed=1)
    recording = simulate_recording(noise_free, motion, 15.0, seed=1, rate=rate)
    found = identify([recording], [], choices)
    truth = truth_of(noise_free)
    size = np.maximum(np.abs(truth), 0.01 * np.max(np.abs(truth)))
    assert np.max(np.abs(found.solution.parameters - truth) / size) < 1e-3
    assert found.fit.relative_error < 1e-4
    assert found.validation.relative_error < 1e-4
    assert found.choices.preprocess.delay == 0.0
    assert np.all(np.isfinite(found.std))


OPTIONS = [
    # method, friction, offset, motor inertia, smoothing, filter, search for a delay
    ("ols", None, None, None, None, "butterworth", True),
    ("wls", "none", False, False, None, "butterworth", False),
    ("wls", "none", True, True, 0.1, "chebyshev", True),
    ("ols", "viscous", False, True, None, "chebyshev", False),
    ("wls", "viscous", True, False, 0.0, "butterworth", True),
    ("ols", "coulomb", True, True, 0.05, "butterworth", False),
    ("wls", "coulomb", False, False, 0.05, "chebyshev", True),
    ("ols", "coulomb-viscous", False, False, 0.1, "chebyshev", True),
    ("wls", "coulomb-viscous", True, True, 0.0, "chebyshev", False),
    ("wls", "coulomb-viscous", False, True, 0.1, "butterworth", True),
    ("ols", "none", None, False, None, "chebyshev", True),
    ("wls", None, False, None, 0.02, "butterworth", False),
]


@alone
@pytest.mark.parametrize(("method", "friction", "offset", "inertia", "smoothing", "kind", "search"), OPTIONS)
def test_every_option_runs_with_every_other(
    recorded, three_joint, method, friction, offset, inertia, smoothing, kind, search
):
    """Columns valid for some combinations of flags only were figaroh's bug, friction "none" BIRDy's."""
    choices = IdentifyChoices(
        method=method,
        model=ModelChoices(friction=friction, offset=offset, motor_inertia=inertia, smoothing=smoothing),
        preprocess=PreprocessChoices(filter=kind),
        search_delay=search,
        presliding=False,
    )
    found = identify([recorded()], [], choices)
    kinds = set(found.base.kinds)
    model = friction or "coulomb-viscous"
    assert ("viscous" in kinds) == ("viscous" in model)
    assert ("coulomb" in kinds) == ("coulomb" in model)
    assert ("offset" in kinds) == (offset is not False)
    assert ("motor_inertia" in kinds) == (inertia is not False)
    assert found.solution.method == method
    assert found.solution.active == tuple(range(found.base.count))
    assert np.all(np.isfinite(found.std))
    assert np.all(found.std > 0)
    assert (found.delay is not None) == search
    complete = {"viscous", "coulomb", "offset", "motor_inertia"} <= kinds
    if complete and not smoothing:
        assert found.validation.relative_error < 0.05
    else:  # what the truth has and the model lacks must show
        assert found.validation.relative_error > found.fit.relative_error * 0.5


@alone
def test_the_full_model_is_within_its_error_bars(recorded, three_joint):
    found = identify([recorded(40.0)], [], IdentifyChoices())
    error = np.abs(found.solution.parameters - truth_of(three_joint)) / found.std
    assert np.mean(error < 1.96) > 0.8
    assert np.max(error) < 5.0


def test_choices_of_columns_change_the_model_and_nothing_else(three_joint):
    model = build_model(three_joint)
    assert apply_model_choices(model, ModelChoices()) == model
    changed = apply_model_choices(
        model, ModelChoices(friction="viscous", offset=False, motor_inertia=False, smoothing=0.3)
    )
    assert changed.viscous == (True,) * 3
    assert changed.coulomb == changed.offset == changed.motor_inertia == (False,) * 3
    assert changed.smoothing == 0.3
    for wrong, why in ((-1.0, "is not within 0 to 10 rad/s"), (np.nan, "finite"), (np.inf, "finite")):
        with pytest.raises(UsageError, match=why):
            apply_model_choices(model, ModelChoices(smoothing=wrong))


@alone
def test_several_recordings_stack(recorded, three_joint):
    parts = [recorded(12.0, seed) for seed in (1, 2, 3)]
    alone = identify(parts[:1], [recorded(8.0, 9)], STATED)
    together = identify(parts, [recorded(8.0, 9)], STATED)
    cutoffs = {run.choices.torque_cutoff for run in (*together.runs, *together.validation_runs)}
    assert len(cutoffs) == 1  # all are treated like the first
    assert together.runs[0].choices.torque_cutoff == alone.runs[0].choices.torque_cutoff
    assert together.solution.rows > 2.5 * alone.solution.rows
    assert np.median(together.std / alone.std) < 0.85
    assert len(together.runs) == 3
    assert len(together.validation_runs) == 1


def test_held_out_part_is_the_end_of_each_recording_and_takes_no_part(recorded, clean):
    spoilt = recorded()
    stream = spoilt.streams[JOINTS_STREAM]
    border = (1 - HELD_OUT_SHARE) * stream.time[-1]
    stream.channels["current"].values[stream.time > border] += 3.0
    found = identify([spoilt], [], IdentifyChoices())
    assert np.array_equal(found.solution.parameters, clean.solution.parameters)
    assert found.validation.relative_error > 3 * clean.validation.relative_error
    assert "last 30 %" in found.validation_source
    assert any("the model overfits" in warning for warning in found.warnings)
    assert not any("overfits" in warning for warning in clean.warnings)


def test_the_order_of_recordings_changes_no_filter(recorded, three_joint):
    """The leading one is chosen by its motion; only the blocks of the error bars are laid along the given order."""
    runs = [recorded(8.0, 5), recorded(12.0)]
    model = build_model(three_joint)
    kernel, every = RegressorKernel(model, base_parameters(model).columns), tuple(range(model.dof))
    found = []
    for order in (runs, runs[::-1]):
        data = split_data(order, [], three_joint.robot, PreprocessChoices(), None)
        assert "last 30 % of each recording, held out" in data.validation_source
        choices = IdentifyChoices(search_delay=False)
        found.append(prepare_data(kernel, data, every, (every, every), choices, lambda step: None).choices)
    assert found[0] == found[1]
    alone = [split_data([run], [], three_joint.robot, PreprocessChoices(), None) for run in runs]
    single = [prepare_data(kernel, data, every, (every,), choices, lambda step: None).choices for data in alone]
    assert found[0].position_cutoff == max(one.position_cutoff for one in single)
    assert single[0].position_cutoff != single[1].position_cutoff


@alone
def test_another_recording_may_be_held_out(recorded, clean):
    found = identify([recorded()], [recorded(8.0, 5)], STATED)
    assert found.validation_source == "recording in memory"
    assert found.runs[0].choices.stop is None
    whole = sum(segment.position.shape[1] for segment in found.runs[0].prepared.segments)
    part = clean.runs[0]
    assert whole > 1.3 * sum(segment.position.shape[1] for segment in part.prepared.segments)


@alone
def test_split_sets_the_border(recorded):
    found = identify([recorded()], [], replace(STATED, split=9.0))
    assert (found.runs[0].choices.start, found.runs[0].choices.stop) == (0.0, 9.0)
    assert found.validation_runs[0].choices.start == 9.0
    assert found.runs[0].prepared.segments[-1].time[-1] < 9.0 <= found.validation_runs[0].prepared.segments[0].time[0]
    assert "after 9 s" in found.validation_source


@pytest.mark.parametrize("split", [-1.0, 0.0, 14.0, 100.0])
def test_a_split_outside_the_data_is_refused(recorded, split):
    with pytest.raises(UsageError, match="outside the data"):
        identify([recorded()], [], IdentifyChoices(split=split))


def test_a_split_outside_the_window_is_refused(recorded):
    choices = IdentifyChoices(split=9.0, preprocess=PreprocessChoices(start=0.0, stop=8.0))
    with pytest.raises(UsageError, match="outside the data"):
        identify([recorded()], [], choices)


def test_split_and_another_recording_exclude_each_other(recorded):
    with pytest.raises(UsageError, match="exclude each other"):
        identify([recorded()], [recorded(8.0, 2)], IdentifyChoices(split=5.0))


def test_nothing_to_identify_from_is_refused():
    with pytest.raises(UsageError, match="no recording"):
        identify([], [], IdentifyChoices())


@alone
def test_a_delay_is_found_and_used(recorded, three_joint):
    late = recorded(20.0)
    stream = late.streams[JOINTS_STREAM]
    current = stream.channels["current"].values
    current[:] = np.roll(current, 2, axis=0)  # 10 ms
    current[:2] = current[2]
    found = identify([late], [], replace(STATED, search_delay=True))
    assert found.choices.preprocess.delay == pytest.approx(0.010, abs=1e-3)
    ignored = identify([late], [], STATED)
    assert found.validation.relative_error < ignored.validation.relative_error
    given = identify([late], [], replace(STATED, preprocess=PreprocessChoices(delay=0.010)))
    assert given.validation.relative_error == pytest.approx(found.validation.relative_error, rel=0.1)


@alone
def test_a_joint_that_is_later_than_the_others_gets_its_own_delay_in_the_result_too(recorded, three_joint):
    late = recorded(20.0)
    current = late.streams[JOINTS_STREAM].channels["current"].values
    current[:, 1] = np.roll(current[:, 1], 4)  # 20 ms
    found = identify([late], [], replace(STATED, search_delay=True))
    first, second, third = found.choices.preprocess.joint_delays
    assert second == pytest.approx(0.020, abs=1.5e-3)
    assert max(abs(first), abs(third)) < 3e-3
    result = Result.model_validate_json(found.result.model_dump_json())
    assert [joint.used for joint in result.delay.joints] == [first, second, third]
    assert result.options["joint_delays"] == [first, second, third]
    assert stored_choices(result).joint_delays == (first, second, third)


def test_short_recordings_are_told_how_long_they_should_be(recorded, clean):
    (text,) = [check.text for check in clean.checks if check.name == "few-equations"]
    assert "equations for 25 parameters" in text
    assert "decimate" not in text  # nobody but the parallel filter did
    needed = float(re.search(r"identify from (\d+) s of motion", text)[1])
    share = 1.0 - HELD_OUT_SHARE
    enough = identify([recorded(1.1 * needed / share)], [], STATED)
    assert "few-equations" not in {check.name for check in enough.checks}
    decimated = identify([recorded()], [], replace(STATED, preprocess=PreprocessChoices(decimate=5, torque_cutoff=5.0)))
    assert any("decimate by less than 5" in check.text for check in decimated.checks)


def test_weights_that_do_not_settle_are_a_check(recorded, clean, monkeypatch):
    assert "weights-not-settled" not in {check.name for check in clean.checks}
    monkeypatch.setattr(least_squares, "WLS_ITERATIONS", 2)
    found = identify([recorded()], [], STATED)
    (check,) = [check for check in found.checks if check.name == "weights-not-settled"]
    assert "in 2 iterations" in check.text
    assert found.validation.relative_error == pytest.approx(clean.validation.relative_error, rel=0.1)


def test_recordings_that_were_not_closed_are_warned_of(recorded):
    found = identify([replace(recorded(), complete=False)], [], STATED)
    assert "recording-not-closed" in [check.name for check in found.checks]


def test_an_arm_that_does_not_move_is_refused(recorded):
    still = recorded()
    still.streams[JOINTS_STREAM].channels["position"].values[:] = 0.4
    with pytest.raises((DataError, IdentificationError)) as caught:
        identify([still], [], IdentifyChoices())
    assert caught.value.hint
    assert "recording in memory" in str(caught.value)
    stopped = recorded()
    position = stopped.streams[JOINTS_STREAM].channels["position"].values
    position[len(position) // 2 :] = position[len(position) // 2]
    with pytest.raises(DataError, match=r"from [\d.]+ s on, which is held out.*--validate"):
        identify([stopped], [], IdentifyChoices(search_delay=False))


@alone
def test_a_given_robot_file_goes_before_the_recordings(recorded, clean, three_joint):
    doubled = parse_robot(three_joint.text.replace("gain: 10,", "gain: 20,"), where="doubled", folder=None)
    found = identify([recorded()], [], IdentifyChoices(), robot_file=doubled)
    place = found.base.names.index("Fs1")
    assert found.solution.parameters[place] == pytest.approx(2 * clean.solution.parameters[place], rel=0.02)
    nameless = replace(recorded(), robot_text="")
    assert np.allclose(
        identify([nameless], [], IdentifyChoices(), robot_file=three_joint).solution.parameters,
        clean.solution.parameters,
        rtol=1e-12,
    )
    with pytest.raises(RecordingError, match="no robot file"):
        identify([nameless], [], IdentifyChoices())


def test_a_robot_with_other_joints_is_refused(recorded):
    with pytest.raises(DataError, match="no column for joint"):
        identify([recorded()], [], IdentifyChoices(), robot_file=load_robot("ur5e"))


@alone
def test_the_last_joint_has_its_acceleration(recorded, three_joint):
    """figaroh lost it: Ia of the last joint then has nothing to be found from."""
    found = identify([recorded(20.0)], [], STATED)
    for run in found.runs:
        for segment in run.prepared.segments:
            assert np.all(np.std(segment.acceleration, axis=1) > 0.5)
            numeric = np.gradient(segment.velocity[2], 1 / segment.rate)
            assert np.allclose(segment.acceleration[2, 2:-2], numeric[2:-2], atol=1e-9)
    place = found.base.names.index("Ia3")
    assert found.solution.parameters[place] == pytest.approx(0.3, abs=5 * found.std[place])
    assert found.std[place] < 0.03


@alone
def test_filters_follow_the_recordings_rate(noise_free):
    """figaroh's filter was made for 100 Hz and 2 Hz whatever it got."""
    motion = random_fourier_motion(build_model(noise_free), 10.0, seed=1)
    found = [
        identify([simulate_recording(noise_free, motion, 14.0, 1, rate=rate)], [], STATED)
        for rate in (100.0, 200.0, 500.0)
    ]
    assert [run.runs[0].prepared.segments[0].rate for run in found] == [100.0, 200.0, 500.0]
    cutoffs = [run.choices.preprocess.torque_cutoff for run in found]
    assert cutoffs == pytest.approx([cutoffs[0]] * 3, rel=0.05)
    for one in found:
        assert one.fit.relative_error < 2e-3


@alone
def test_gaps_make_segments_and_do_no_harm(recorded, three_joint):
    whole = recorded(40.0)
    time = whole.streams[JOINTS_STREAM].time
    holes = np.ones(len(time), dtype=bool)
    for start in (7.0, 16.3, 25.1):
        holes[(time > start) & (time < start + 0.7)] = False
    broken = with_rows(whole, holes)
    # A shorter stretch blurs the motion's band: with cut-offs of their own the two could not be compared.
    choices = replace(STATED, preprocess=PreprocessChoices(position_cutoff=20.0, torque_cutoff=10.0))
    found, reference = identify([broken], [], choices), identify([whole], [], choices)
    assert len(found.runs[0].prepared.segments) == 4
    assert len(found.fit_series) == 4
    assert found.reduction.samples < reference.reduction.samples
    assert found.validation.relative_error < 1.1 * reference.validation.relative_error
    error = np.abs(found.solution.parameters - truth_of(three_joint)) / found.std
    assert np.max(error) < 5.0


@alone
def test_weights_belong_to_identified_joints_not_to_all_of_the_urdf(three_joint):
    """figaroh sized its weights by model.nv: wrong as soon as a joint is locked (a gripper's finger)."""
    urdf = """<robot name="locked"><link name="l0"/><link name="l1"/><link name="l2"/><link name="l3"/>
    <joint name="a" type="revolute"><parent link="l0"/><child link="l1"/><axis xyz="0 0 1"/>{limit}</joint>
    <joint name="finger" type="prismatic"><parent link="l1"/><child link="l2"/><axis xyz="1 0 0"/>{limit}</joint>
    <joint name="b" type="revolute"><parent link="l2"/><child link="l3"/><axis xyz="0 1 0"/>{limit}</joint></robot>"""
    urdf = urdf.replace("{limit}", '<limit lower="-3" upper="3" velocity="3" effort="50"/>')
    text = """
name: locked
model: {urdf: locked.urdf, locked: {finger: 0.2}}
joints:
  - {name: a, position: [-3, 3], velocity: 3}
  - {name: b, position: [-3, 3], velocity: 3}
drives: [{joint: a, gain: 5}, {joint: b, gain: 2}]
truth:
  links:
    a: {mass: 3, com: [0.1, 0, 0], inertia: [0.01, 0, 0, 0.02, 0, 0.02]}
    b: {mass: 1, com: [0.1, 0.02, 0.1], inertia: [0.01, 0, 0, 0.01, 0, 0.01]}
  joints:
    a: {viscous: 1, coulomb: 2, motor_inertia: 0.5}
    b: {viscous: 0.5, coulomb: 0.7, motor_inertia: 0.2}
  noise: {rate: 200, torque_std: {a: 2.0, b: 0.02}}
"""
    robot_file = parse_robot(text, where="locked", folder=None, urdf_text=urdf)
    recording = simulate_recording(robot_file, random_fourier_motion(build_model(robot_file), 10.0, 1), 14.0, 1)
    found = identify([recording], [], STATED)
    assert found.solution.weights.shape == (2,)
    assert found.solution.weights[1] > 30 * found.solution.weights[0]
    error = np.abs(found.solution.parameters - truth_of(robot_file)) / found.std
    assert np.max(error) < 5.0


def test_too_little_data_is_refused_in_words(recorded):
    with pytest.raises((DataError, UsageError, IdentificationError)) as caught:
        identify([recorded(0.2)], [], IdentifyChoices())
    assert caught.value.hint


def test_progress_names_the_steps(recorded):
    steps = []
    identify([recorded()], [], IdentifyChoices(), progress=steps.append)
    assert steps == [
        "base parameters", "preprocessing", "delay", "friction", "presliding", "regression", "error bars",
        "physical consistency", "validation", "plausibility", "simulation",
    ]  # fmt: skip


@pytest.mark.usefixtures("estimate_alone")
def test_error_bars_cover_the_truth(three_joint):
    """95 % intervals over ten motions; classical ones are far too short. Six joints: studies/coverage/coverage.py."""
    corrected, classical = [], []
    truth = truth_of(three_joint)
    for seed in range(10):
        motion = random_fourier_motion(build_model(three_joint), 20.0, seed, candidates=3)
        found = identify(
            [simulate_recording(three_joint, motion, 22.0, seed, rate=100.0)], [], replace(STATED, split=20.0)
        )
        error = np.abs(found.solution.parameters - truth)
        corrected.append(error <= 1.96 * found.std)
        classical.append(error <= 1.96 * found.solution.std)
    share, naive = np.mean(corrected), np.mean(classical)
    assert 0.93 <= share <= 0.98
    assert naive < share - 0.1


@alone
def test_recordings_of_different_rates_get_the_same_cut_offs(three_joint):
    model = build_model(three_joint)
    fast, slow = (
        simulate_recording(three_joint, random_fourier_motion(model, 12.0, seed, 3), 12.0, seed, rate=rate)
        for seed, rate in ((1, 500.0), (2, 125.0))
    )
    found = identify([fast], [slow], STATED)
    filters = [run.prepared.parallel_filter for run in (*found.runs, *found.validation_runs)]
    cutoffs = {run.prepared.choices.torque_cutoff for run in (*found.runs, *found.validation_runs)}
    assert len(cutoffs) == 1
    assert filters[0].factor > 3 * filters[1].factor
    assert found.validation.relative_error < 0.1


def test_friction_that_sticks_at_reversals_is_warned_of(recorded, three_joint):
    def warned(found):
        return [text for text in found.warnings if "near velocity reversals" in text]

    clean = recorded(20.0)
    assert not warned(identify([clean], [], replace(STATED, reversals=0.0)))
    stream = clean.streams[JOINTS_STREAM]
    current = stream.channels["current"].values
    speed = np.gradient(stream.channels["position"].values, stream.time, axis=0)
    slow = np.abs(speed) < 0.1 * np.sqrt(np.mean(speed**2, axis=0))
    stuck = current - np.where(slow, 0.3 * np.abs(current).mean(axis=0) * np.sign(speed), 0.0)
    sticking = with_values(clean, current=stuck)
    (told,) = warned(identify([sticking], [], replace(STATED, reversals=0.0)))
    assert "Fs" in told
    assert f"--reversals {STICKING_SHARE:g}" in told
    assert warned(identify([sticking], [], STATED))
    assert not warned(identify([sticking], [], replace(STATED, reversals=STICKING_SHARE)))
    assert not warned(identify([sticking], [], replace(STATED, model=ModelChoices(friction="viscous"))))
