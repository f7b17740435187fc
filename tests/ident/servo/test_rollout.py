"""Roll-outs of servo joints: derivatives, sticking, profiles, and the choice of steps."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from each import each

from daq.recording.commanded_motion import CommandedMotion
from ident.compiled.library import Kernels, kernels
from ident.servo import search
from ident.servo.first_fit import believed
from ident.servo.motion import servo_motions
from ident.servo.rollout import goals, rollout
from ident.servo.rollout.goals import goals_of, profile_goals
from ident.servo.rollout.lanes import THINNED, Lanes, Touch, at_samples
from ident.servo.rollout.rollout import roll_out, with_pull
from ident.servo.search import evaluate
from ident.servo.terms import GROUPS, INDEX, TERMS, from_search, members, start_values, to_search, with_group

SMOOTH = [term.name for term in TERMS if term.name not in ("delay", "acceleration_limit", "backlash")]
"""Their derivatives are exact; that of a delay is to one side, those of profile and play stand for a finite span."""


def lanes(steps: int = 300, seed: int = 0, load: float = 0.37, step: float = 0.005) -> Lanes:
    """Three joints on sines, with gravity; commands are those of the middle of each step."""
    generator = np.random.default_rng(seed)
    history = round(0.3 / step)
    times = (np.arange(-history, steps) - 0.5) * step
    rates, phases = generator.uniform(2.0, 8.0, 3), generator.uniform(0.0, 6.0, 3)
    command = 0.3 * np.sin(rates * times[:, None] + phases)
    joint = np.arange(3)
    return Lanes(
        step,
        joint,
        np.zeros(3, dtype=np.intp),
        command,
        history,
        0.3 * np.sin(phases),
        np.full((steps, 3), 0.01),
        np.full((steps, 3), load),
        np.full((steps, 3), 0.2),
        np.tile(np.arange(0, steps - 4, 4.0)[:, None], (1, 3)),
        np.zeros((len(range(0, steps - 4, 4)), 3)),
    )


def arm_lanes(steps: int = 300, step: float = 0.005) -> Lanes:
    """Two pieces of an arm of three joints that weigh more on each other than on themselves."""
    pieces = [lanes(steps, seed, step=step) for seed in (0, 1)]
    wide = {
        name: np.concatenate([getattr(piece, name) for piece in pieces], axis=-1)
        for name in ("command", "start", "inertia", "load", "load_slope", "sample", "measured", "joint")
    }
    matrix = np.array([[0.0, 0.02, 0.006], [0.02, 0.0, 0.015], [0.006, 0.015, 0.0]])
    slowly = np.cos(np.arange(0, steps + THINNED, THINNED) * step)[:, None, None, None]
    between = np.tile(matrix, (2, 1, 1)) * (1.0 + 0.1 * slowly)
    wide["inertia"] = wide["inertia"] + np.tile([0.05, 0.04, 0.01], 2)
    return dataclasses.replace(pieces[0], **wide, piece=np.repeat([0, 1], 3), between=between)


def touching(moved: Lanes) -> tuple[Lanes, np.ndarray]:
    """The lanes with a point that the first two joints move, and a surface that it reaches."""
    pieces, width = len(moved.joint) // 3, len(moved.joint)
    lever = np.zeros((4, len(moved.load), width))
    lever[0, :, 0::3], lever[0, :, 1::3] = -1.0, 0.3
    touch = Touch(np.zeros(moved.load.shape), np.zeros((4, len(moved.load), pieces)), lever)
    return dataclasses.replace(moved, touch=touch), np.tile([[-0.1], [800.0], [0.0], [0.0], [0.0]], (1, pieces))


def every_term() -> tuple[np.ndarray, np.ndarray]:
    """Values of three joints with all terms, and which are searched."""
    values = start_values(3)
    free = np.zeros(values.shape, dtype=np.bool_)
    free[:, members("")] = True
    for group in GROUPS:
        if group != "backlash":  # whose derivatives are near, not exact
            values, free = with_group(values, free, range(3), group)
    return values, free


@each("name", SMOOTH)
def test_derivatives_are_those_of_the_roll_out(name):
    values, free = every_term()
    moved, point, column = lanes(), to_search(values), INDEX[name]
    tangents = evaluate(moved, values, free)[1][:, :, np.searchsorted(np.flatnonzero(free.any(axis=0)), column)].T
    ends = []
    for shift in (1e-6, -1e-6):
        there = point.copy()
        there[:, column] += shift
        ends.append(evaluate(moved, from_search(there))[0])
    differences = (ends[0] - ends[1]) / 2e-6
    # a joint that starts or stops sticking in another step is the exception
    assert np.mean(np.abs(differences - tangents) < 1e-6 + 1e-4 * np.abs(tangents).max()) > 0.98


def test_steps_of_5_ms_are_neither_ahead_of_a_joint_nor_damp_it():
    values = start_values(3)
    values[:, INDEX["damping"]] = 0.1  # underdamped: an implicit step would add half of it
    values[:, INDEX["load_friction"]] = 0.1
    fine, coarse, coarser = (
        roll_out(lanes(round(1.5 / step), step=step), values.T)[0][:: round(0.01 / step)]
        for step in (0.0002, 0.005, 0.01)
    )
    near, far = (np.abs(path[:150] - fine).mean() for path in (coarse, coarser))
    assert near < 2e-4
    assert near < 0.5 * far


def test_the_library_computes_what_numpy_does(monkeypatch):
    if kernels().long is None:
        pytest.skip(kernels().said)
    values, _ = every_term()
    free = np.arange(len(TERMS))
    touched, surface = touching(arm_lanes())
    # profiles and none; joints on their own, of one arm, and with something that they touch
    for moved, steepest, pushed in (
        (lanes(), values[:, INDEX["acceleration_limit"]], None),
        (lanes(), np.full(3, 1e7), None),
        (arm_lanes(), np.full(3, 1e7), None),
        (touched, np.full(3, 1e7), surface),
        (dataclasses.replace(touched, between=None), np.full(3, 1e7), surface),
    ):
        values[:, INDEX["acceleration_limit"]] = steepest
        terms = None if pushed is not None else free if moved.between is None else np.tile(free, 3)
        owners = None if moved.between is None else np.repeat(np.arange(3), len(free))
        found = roll_out(moved, values[moved.joint].T, terms, owners, pushed)
        with monkeypatch.context() as without:
            for module in (rollout, goals):
                without.setattr(module, "kernels", lambda: Kernels(None, None, "off"))
            expected = roll_out(moved, values[moved.joint].T, terms, owners, pushed)
        for own, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(own, other, rtol=1e-6, atol=1e-8)
        assert pushed is None or found.force.max() > 1.0


def test_joints_of_one_arm_move_each_other_as_one_system():
    moved, values = arm_lanes(), start_values(3)
    values[:, INDEX["coulomb"]] = 0.05
    found = roll_out(moved, values[moved.joint].T)
    # what the others ask for, taken as known, moves each joint alike
    alone = roll_out(with_pull(moved, values), values[moved.joint].T)
    np.testing.assert_allclose(alone.path, found.path, atol=1e-9)
    assert np.abs(found.pull).max() > 0.1
    # steps of a fifth of the length come to the same path
    fine = roll_out(arm_lanes(1500, 0.001), values[moved.joint].T).path[::5]
    assert np.abs(found.path - fine).max() < 2e-3


def test_derivatives_of_an_arm_are_those_by_the_terms_of_every_joint():
    moved, values = arm_lanes(), start_values(3)
    values[:, INDEX["coulomb"]] = 1e-6  # sticking has derivatives that jump
    free = np.array([INDEX["stiffness"], INDEX["armature"], INDEX["bias"]])
    owners, terms = np.repeat(np.arange(3), 3), np.tile(free, 3)
    slopes = roll_out(moved, values[moved.joint].T, terms, owners).slopes
    for column, (owner, term) in enumerate(zip(owners, terms, strict=True)):
        ends = []
        for shift in (1e-5, -1e-5):
            point = to_search(values)
            point[owner, term] += shift
            ends.append(at_samples(moved, roll_out(moved, from_search(point)[moved.joint].T).path))
        difference = (ends[0] - ends[1]) / 2e-5
        found = np.moveaxis(slopes[..., column], 1, 0).reshape(difference.shape)
        wrong = np.abs(difference - found) > 1e-4 + 1e-3 * np.abs(difference).max()
        assert wrong.mean() < 0.02, (owner, TERMS[term].name)


def test_a_search_does_not_end_where_tangents_of_its_trials_lead_astray(monkeypatch):
    monkeypatch.setattr(search._Descent, "averaged", lambda descent: descent.best[0] + 2.0)
    moved, (values, free) = arm_lanes(), every_term()
    scale = np.full(3, 0.05)

    def cost(point: np.ndarray) -> float:
        return float(search.joint_cost(evaluate(moved, point)[0], moved, scale, search.EVERY_ERROR).sum())

    found = search.search(moved, values, free, scale, to_search(values), 3, search.EVERY_ERROR)
    assert cost(found) < cost(values)


def test_what_was_declared_is_believed_until_the_data_clearly_contradict():
    moved, values = lanes(), start_values(3)
    noise = 2e-3 * np.random.default_rng(0).standard_normal(moved.measured.shape)
    moved = dataclasses.replace(moved, measured=evaluate(moved, values)[0] + noise)
    nearly, wrong = values.copy(), values.copy()
    nearly[:, INDEX["stiffness"]] *= 1.001
    wrong[:, INDEX["stiffness"]] *= 1.5
    assert believed(moved, [values, nearly], 1e-3) == 1
    assert believed(moved, [values, wrong], 1e-3) == 0
    assert believed(moved, [values], 1e-3) == 0


def test_a_joint_sticks_where_its_friction_holds_it():
    values = start_values(3)
    values[:, INDEX["coulomb"]] = 1.0
    still = lanes(load=0.5)
    held = Lanes(**{**vars(still), "command": np.zeros_like(still.command), "start": np.zeros(3)})
    assert np.all(roll_out(held, values.T)[0] == 0.0)


def test_play_moves_a_joint_as_motor_and_link_that_a_stiff_gear_holds_together():
    if kernels().long is None:
        pytest.skip(kernels().said)
    values, play, moved = start_values(3), np.array([0.01, 0.02, 0.04]), lanes(steps=160, load=0.0)
    values[:, INDEX["damping"]] = 0.1
    still = np.zeros_like(moved.load_slope)
    moved = dataclasses.replace(moved, command=np.full_like(moved.command, 0.2), start=np.zeros(3), load_slope=still)
    paths = []
    for widths in (np.zeros(3), play):
        values[:, INDEX["backlash"]] = widths
        paths.append(roll_out(moved, values.T).path)
    motor, inertia, gear, step = values[0, INDEX["armature"]], 0.01, 2000.0, 5e-5
    damping, coulomb, stiffness = (values[0, INDEX[name]] for name in ("damping", "coulomb", "stiffness"))
    bodies, rates, fine = np.zeros((2, 3)), np.zeros((2, 3)), np.empty_like(paths[0])
    dry = coulomb * np.array([[0.8], [0.2]])  # of the motor, and of the joint behind the play
    for index in range(len(fine) * 100):
        fine[index // 100] = bodies[1] if index % 100 == 0 else fine[index // 100]
        ahead = bodies[0] - bodies[1]
        beyond = ahead - np.clip(ahead, -play / 2, play / 2)
        torque = np.where(beyond != 0, gear * beyond + 2.0 * (rates[0] - rates[1]), 0.0)
        torque = np.where(torque * beyond > 0, torque, 0.0)
        drive = stiffness * (0.2 - bodies[1]) - damping * rates[0]
        push = np.stack([(drive - torque) / motor, torque / inertia])
        rates = rates + step * (push - dry / np.array([[motor], [inertia]]) * np.tanh(rates / 2e-3))
        bodies = bodies + step * rates
    without, errors = (np.abs(path - fine).mean(axis=0) for path in paths)
    assert np.all(errors < 0.2 * without), (errors, without)


def test_a_stiff_servo_without_friction_settles_on_command_and_load():
    values = start_values(3)
    values[:, INDEX["coulomb"]] = 1e-9
    values[:, INDEX["bias"]] = 0.01
    moved = lanes(steps=2000)
    held = Lanes(**{**vars(moved), "command": np.full_like(moved.command, 0.2), "start": np.zeros(3)})
    expected = 0.2 - 0.01 - 0.37 / values[:, INDEX["stiffness"]]
    assert roll_out(held, values.T)[0][-1] == pytest.approx(expected, abs=1e-6)


def test_a_profile_keeps_its_acceleration_and_stops_at_its_target():
    moved = lanes(steps=400)
    command = np.where(np.arange(len(moved.command))[:, None] < moved.history + 20, 0.0, 1.0) * np.ones(3)
    limits = np.array([5.0, 20.0, 80.0])
    goals = profile_goals(command, moved.step, limits)
    acceleration = np.diff(goals, 2, axis=0) / moved.step**2
    assert np.all(np.abs(acceleration).max(axis=0) <= limits * (1 + 1e-6))
    assert goals[-1] == pytest.approx(np.ones(3), abs=1e-6)
    # a step may pass it by what one step of braking covers
    assert np.all(goals <= 1.0 + limits * moved.step**2)


def test_a_later_command_is_followed_later_and_otherwise_alike():
    values = start_values(3)
    values[:, INDEX["acceleration_limit"]] = 40.0
    moved = lanes(steps=400)
    late, later = values.copy(), values.copy()
    late[:, INDEX["delay"]], later[:, INDEX["delay"]] = 0.0, 2.5 * moved.step
    delay, limit = INDEX["delay"], INDEX["acceleration_limit"]
    found = [goals_of(moved, own[:, delay], own[:, limit], ()) for own in (late, later)]
    goals = [each.late * each.path[:-1] + (1.0 - each.late) * each.path[1:] for each in found]
    steps = np.arange(400.0)
    shifted = np.stack([np.interp(steps[10:] - 2.5, steps, column) for column in goals[0].T], axis=1)
    np.testing.assert_allclose(goals[1][10:], shifted, atol=1e-12)


def test_a_command_holds_from_its_stamp_until_the_next():
    stamps = np.arange(200) * 0.02 + 0.003
    command = np.cumsum(np.random.default_rng(1).standard_normal((200, 1)), axis=0)
    given = CommandedMotion(("a",), stamps, np.zeros((200, 1)), stamps, {"target_position": command})
    motion = servo_motions(given, "run")[0]
    ends = motion.grid[1:] + motion.begin
    inside = (ends[:, None] - motion.step * np.linspace(0.999, 0.001, 50)).ravel()
    means = given.held(inside).reshape(len(ends), 50).mean(axis=1)
    np.testing.assert_allclose(motion.command[motion.history + 1 :, 0], means, atol=0.05)


def test_a_surface_holds_what_pushes_on_it_and_nothing_else():
    values = start_values(3)
    values[:, INDEX["coulomb"]] = 1e-9
    steps = 800
    lever = np.zeros((4, steps, 3))
    lever[0, :, 0] = -1.0
    touch = Touch(np.zeros((steps, 3)), np.zeros((4, steps, 1)), lever)
    moved = lanes(steps=steps)
    held = dataclasses.replace(moved, command=np.full_like(moved.command, 0.2), start=np.zeros(3), touch=touch)
    path, _, force, _ = roll_out(held, values.T, surface=np.array([[-0.1], [1000.0], [0.0], [0.0], [0.0]]))
    pressed = (15.0 * 0.1 - 0.37) / (1.0 + 15.0 / 1000.0)
    assert force[-1] == pytest.approx(pressed, rel=1e-4)
    assert path[-1] == pytest.approx([0.1 + pressed / 1000.0, 0.2 - 0.37 / 15.0, 0.2 - 0.37 / 15.0], abs=1e-5)
    assert np.all(force >= 0.0)
    assert np.all(force[path[:, 0] < 0.05] == 0.0)
