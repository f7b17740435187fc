"""Every check of the catalogue: a recording (or a model) that raises it, and one that does not."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import numpy as np
import pytest
import yaml
from check_bench import (
    PERIOD,
    SEARCHED,
    Bench,
    Names,
    at_rest,
    bursts,
    changed,
    coupled,
    exchanged,
    exchanged_with_velocity,
    glitches,
    noisy,
    servo,
    shifted_from_the_middle,
    spoilt_end,
    stamped,
    taken_for,
    without_rows,
)
from exported_arms import exported_arm

from daq.recording.recording import HAND_GUIDED, JOINTS_STREAM, MOTOR_SIGNALS, Event, Recording
from daq.robot.loader import RobotFile, parse_robot
from ident.export import mujoco_reading, pinocchio_reading
from ident.export.arm import ExportedArm
from ident.export.export import export_mjcf
from ident.export.reading import simulation_checks
from ident.export.urdf import new_urdf
from ident.identify.identification import ModelChoices
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.regression.options import ExperimentChoices
from ident.signals.pipeline import PreprocessChoices
from ident.verdict.catalogue import CATALOGUE
from sim_drivers.plant.altered_arm import with_load
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.synthetic.data_mistakes import (
    contact,
    filled_with_zeros,
    jittering_position,
    repeated_rows,
    stuck_encoder,
    with_rows,
    with_velocity,
)


def exported(robot_file: RobotFile) -> ExportedArm:
    """The true arm."""
    return exported_arm(robot_file, truth_vector(robot_file))


def beside_its_urdf(bench: Bench, factor: float = 1.0, turn: float = 0.0) -> Names:
    """Checks of torques times a factor, and of another zero [°] of the last joint, beside the true URDF."""
    content = yaml.safe_load(bench.arm.text) | {"model": {"urdf": "arm.urdf"}}
    urdf = new_urdf(exported(bench.arm))
    robot_file = parse_robot(yaml.safe_dump(content), where="arm", folder=Path(), urdf_text=urdf)
    moved = changed(bench.recorded(), lambda q: q + np.deg2rad([0.0, 0.0, turn]), "position")
    return bench.found(changed(moved, lambda i: factor * i), robot_file=robot_file)


def in_simulation(arm: ExportedArm, **dynamics: str) -> Names:
    """Checks of a URDF whose joints have other `dynamics`."""
    text = new_urdf(arm)
    for name, value in dynamics.items():
        text = re.sub(f' {name}="[^"]*"', f' {name}="{value}"', text)
    return frozenset(check.name for check in simulation_checks(pinocchio_reading.read_urdf(arm, text)))


def in_mujoco(arm: ExportedArm) -> Names:
    """Checks of an MJCF."""
    pytest.importorskip("mujoco")
    return mjcf_checks(arm)


def off_at_first(run: Recording, rows: int) -> Recording:
    """The run after a time in which the motors were off."""
    stream = run.streams[JOINTS_STREAM]
    at = np.maximum(np.arange(-rows, len(stream.time)), 0)
    time = stream.time[0] + PERIOD * np.arange(len(at), dtype=np.float64)
    channels = {name: replace(channel, values=channel.values[at]) for name, channel in stream.channels.items()}
    for name in MOTOR_SIGNALS:
        if name in channels:
            channels[name].values[:rows] = 0.0
    return replace(run, streams={JOINTS_STREAM: replace(stream, time=time, host_time=time, channels=channels)})


def without_mujoco(arm: ExportedArm) -> Names:
    """The same where MuJoCo is not installed."""
    with patch.object(mujoco_reading, "mujoco_installed", lambda: False):
        return mjcf_checks(arm)


def mjcf_checks(arm: ExportedArm) -> Names:
    with TemporaryDirectory() as folder:
        return frozenset(check.name for check in export_mjcf(arm, Path(folder) / "arm.xml").checks)


CASES: dict[str, tuple[Callable[[Bench], Names], Callable[[Bench], Names]]] = {
    "recording-not-closed": (lambda b: b.names(replace(b.recorded(), complete=False)), lambda b: b.clean_names()),
    "wrong-time-axis": (
        lambda b: b.names(stamped(b.with_velocity(), lambda t: 1.25 * t)),
        lambda b: b.names(b.with_velocity()),
    ),
    "velocity-scale": (
        lambda b: b.names(b.with_velocity((1.0, 1.0, 0.5))),
        lambda b: b.names(b.with_velocity()) | b.stuck(),
    ),
    "clocks-drift": (lambda b: b.names(b.drifting_clock()), lambda b: b.clean_names()),
    "torque-ahead": (lambda b: b.all_late(), lambda b: b.late_and_ahead()),
    "torque-late": (
        lambda b: b.found(changed(b.recorded(), lambda i: np.roll(i, 3, axis=0)), search_delay=True),
        lambda b: b.clean(),
    ),
    "search-gap": (
        lambda b: b.found(method="wls-pso:generations=2"),
        lambda b: b.found(method="wls-pso:generations=2:box=1e-6"),
    ),
    "weights-not-settled": (lambda b: b.unsettled(), lambda b: b.clean()),
    "no-consistent-model": (lambda b: b.inconsistent(), lambda b: b.clean()),
    "simulation-failed": (lambda b: b.diverging(), lambda b: b.clean()),
    "consistency-costs": (lambda b: b.opposite(), lambda b: b.clean()),
    "links-on-boundary": (lambda b: b.opposite(), lambda b: b.clean()),
    "implausible-mass": (lambda b: b.tested(changed(b.recorded(), lambda i: 0.01 * i)), lambda b: b.clean()),
    "torques-scaled": (
        lambda b: beside_its_urdf(b, 1.3),
        lambda b: beside_its_urdf(b, 1.0) | beside_its_urdf(b, turn=8.0),
    ),
    "torque-biased": (
        lambda b: b.found(changed(b.recorded(), lambda i: i + [0.0, 4.0, 0.0])),
        lambda b: b.found(changed(b.recorded(), lambda i: i + [0.0, 0.1, 0.0])),
    ),
    "implausible-link": (lambda b: b.tested(changed(b.recorded(), lambda i: 200 * i)), lambda b: b.clean()),
    "implausible-centre": (
        lambda b: b.tested(robot_file=b.said({"r: 0.3": "r: 0.03", "d: 0.4, r: 0.1": "d: 0.04, r: 0.01"})),
        lambda b: b.clean(),
    ),
    "known-contradicts-data": (
        lambda b: b.in_a_narrow_range(),
        lambda b: b.tested(robot_file=b.said({"drives:\n": "known: {Fv1: {max: 9}, M3: 2}\ndrives:\n"})),
    ),
    "known-implausible": (
        lambda b: b.tested(robot_file=b.said({"drives:\n": "known: {M1: 4000}\ndrives:\n"})),
        lambda b: b.tested(robot_file=b.said({"drives:\n": "known: {M1: 4}\ndrives:\n"})),
    ),
    "weight-not-separate": (lambda b: b.lift(), lambda b: b.clean()),
    "consistency-rejected": (lambda b: b.opposite(), lambda b: b.clean() | b.lift()),
    "armature-assumed": (
        lambda b: b.found(robot_file=b.said({"gain_std: 0.2}": "gain_std: 0.2, inertia: false}"})),
        lambda b: b.found(robot_file=b.said({"gain_std: 0.2}": "gain_std: 0.2, inertia: false, armature: 0.3}"})),
    ),
    "errors-near-standstill": (
        lambda b: b.found(validation=(b.sticking(3, 30.0, (0.2, 0.2, 0.2)),)),
        lambda b: b.found(validation=(b.recorded(3, 30.0, (0.2, 0.2, 0.2)),)),
    ),
    "range-hit": (
        lambda b: b.in_a_narrow_range(),
        lambda b: b.found(robot_file=b.said({"drives:\n": "known: {Fv1: {max: 9}}\ndrives:\n"})),
    ),
    "hand-guided": (
        lambda b: b.names(replace(b.recorded(), events=(Event(0.0, "info", "session", f"{HAND_GUIDED}: limp"),))),
        lambda b: b.names(replace(b.recorded(), events=(Event(0.0, "info", "player", "motion begins"),))),
    ),
    "import-warning": (
        lambda b: b.names(replace(b.recorded(), events=(Event(0.0, "warning", "import", "sort: 3 samples"),))),
        lambda b: b.names(replace(b.recorded(), events=(Event(0.0, "info", "import", "time converted"),))),
    ),
    "samples-lost": (lambda b: b.names(with_rows(b.recorded(), np.r_[0:1000, 1100:6000])), lambda b: b.clean_names()),
    "repeated-stamps": (
        lambda b: b.names(stamped(b.recorded(), lambda t: np.r_[t[:1000], t[999], t[1001:]])),
        lambda b: b.clean_names(),
    ),
    "jittering-stamps": (
        lambda b: b.names(stamped(b.recorded(), lambda t: t + 4e-3 * np.random.default_rng(1).random(len(t)))),
        lambda b: b.names(stamped(b.recorded(), lambda t: t + 2e-4 * np.random.default_rng(1).random(len(t)))),
    ),
    "unsigned-signal": (lambda b: b.names(changed(b.recorded(), np.abs)), lambda b: b.clean_names()),
    "no-torque": (lambda b: b.servo_info(), lambda b: b.clean_info()),
    "positions-alone": (
        lambda b: b.info(replace(servo(b.recorded()), streams={JOINTS_STREAM: servo(b.recorded()).streams["joints"]})),
        lambda b: b.servo_info(),
    ),
    "commands-short": (lambda b: b.info(servo(b.recorded(), last=25.0)), lambda b: b.servo_info()),
    "command-clock": (
        lambda b: b.info(servo(b.recorded(), late=0.3)),
        lambda b: b.info(servo(b.recorded(), late=-0.1)),
    ),
    "command-order": (
        lambda b: b.info(servo(b.recorded(), lambda q: q[:, [0, 2, 1]])) & b.info(servo(b.recorded(), np.negative)),
        lambda b: b.servo_info(),
    ),
    "command-unit": (
        lambda b: b.info(servo(b.recorded(), np.rad2deg)) & b.info(servo(b.recorded(), lambda q: q + [0.0, 0.5, 0.0])),
        lambda b: b.servo_info(),
    ),
    "command-other": (
        lambda b: b.info(servo(b.recorded(), lambda q: np.diff(q, axis=0, prepend=q[:1]))),
        lambda b: b.servo_info(),
    ),
    "joint-at-rest": (lambda b: b.info(servo(at_rest(b.recorded(), 1))), lambda b: b.servo_info()),
    "signal-clipped": (
        lambda b: b.names(changed(b.recorded(), lambda i: np.clip(i, -0.5 * i.max(axis=0), 0.5 * i.max(axis=0)))),
        lambda b: b.clean_names() | b.names(changed(b.recorded(), lambda i: np.round(i * (60.0 / i.max(axis=0))))),
    ),
    "outliers-replaced": (
        lambda b: b.info(changed(b.recorded(), glitches(1e-3), "position")),
        lambda b: b.clean_info(),
    ),
    "many-outliers": (
        lambda b: b.found(changed(b.recorded(), glitches(0.04), "position")),
        lambda b: b.found(changed(b.recorded(), glitches(1e-3), "position")),
    ),
    "motors-off": (lambda b: b.names(off_at_first(b.recorded(), 100)), lambda b: b.clean_names()),
    "rows-repeated": (lambda b: b.names(repeated_rows(b.recorded(), 0.1, 1)), lambda b: b.clean_names()),
    "encoder-stuck": (
        lambda b: (
            b.stuck()
            & b.names(stuck_encoder(servo(b.recorded()), 1, 3.0, 1.0))
            & b.info(stuck_encoder(servo(b.recorded()), 1, -1.0, 40.0))
        ),
        lambda b: b.names_with_velocity(),
    ),
    "position-jump": (lambda b: b.names_of_a_jump(), lambda b: b.clean_names()),
    "position-wraps": (
        lambda b: b.names(changed(b.recorded(), shifted_from_the_middle(2.0 * np.pi), "position")),
        lambda b: b.names_of_a_jump(),
    ),
    "rows-missing": (lambda b: b.names(without_rows(b.recorded(), 600, 900)), lambda b: b.names_of_a_jump()),
    "motion-as-torque": (
        lambda b: b.names(taken_for(with_velocity(b.recorded()), "current", "velocity", 180.0 / np.pi)),
        lambda b: b.names_with_velocity(),
    ),
    "steady-torque": (
        lambda b: b.names(changed(b.recorded(), lambda i: 30.0 + np.arange(len(i))[:, None] * [1e-3, 2e-3, 1e-3])),
        lambda b: b.clean_names(),
    ),
    "same-column": (lambda b: b.names(changed(b.recorded(), lambda i: i[:, [0, 1, 0]])), lambda b: b.clean_names()),
    "torque-frozen": (
        lambda b: b.names(changed(b.recorded(), lambda i: np.r_[i[:400], i[[400] * 200], i[600:]])),
        lambda b: b.clean_names(),
    ),
    "torque-wraps": (
        lambda b: b.names(changed(b.recorded(), lambda i: i % (0.5 * np.ptp(i, axis=0)))),
        lambda b: b.clean_names(),
    ),
    "position-velocity-exchanged": (
        lambda b: b.names(exchanged_with_velocity(with_velocity(b.recorded()))),
        lambda b: b.names_with_velocity(),
    ),
    "recording-changes": (
        lambda b: b.tested(changed(b.recorded(), lambda i: i * np.linspace([1.0] * 3, [1.0, 1.2, 1.0], len(i)))),
        lambda b: b.clean(),
    ),
    "filled-with-zeros": (lambda b: b.names(filled_with_zeros(b.recorded(), 0.5, 1)), lambda b: b.clean_names()),
    "positions-jitter": (lambda b: b.tested(jittering_position(b.recorded(), 0.02, 1)), lambda b: b.clean()),
    "residual-bursts": (lambda b: b.tested(contact(b.recorded(), 0.05, 1.0, 1)), lambda b: b.clean() | b.late()),
    "few-parameters-determined": (
        lambda b: b.info(changed(b.recorded(1, 4.5, (0.02, 0.02, 0.02)), noisy)),
        lambda b: b.clean_info(),
    ),
    "values-unusable": (
        lambda b: b.names(changed(b.recorded(), lambda i: np.where(i == i.max(), np.nan, i))),
        lambda b: b.clean_names(),
    ),
    "no-motion": (
        lambda b: b.info(changed(b.recorded(), lambda q: np.zeros_like(q), "position")),
        lambda b: b.clean_info(),
    ),
    "one-direction": (lambda b: b.found(b.one_way()), lambda b: b.clean()),
    "extrapolation": (lambda b: b.found(b.recorded(1, 30.0, (0.05, 0.05, 0.05))), lambda b: b.clean() | b.lift()),
    "high-condition": (lambda b: b.info(b.recorded(1, 30.0, (1, 0.02, 1))), lambda b: b.clean_info()),
    "slow-motion": (lambda b: b.info(b.recorded(1, 30.0, (0.1, 0.1, 0.1))), lambda b: b.clean_info()),
    "torque-beyond-limits": (lambda b: b.info(changed(b.recorded(), lambda i: 1e3 * i)), lambda b: b.clean_info()),
    "torque-far-below-limits": (lambda b: b.tested(changed(b.recorded(), lambda i: 1e-3 * i)), lambda b: b.clean()),
    "implausible-load": (
        lambda b: b.tested(
            changed(b.recorded(), lambda i: 1e3 * i), robot_file=b.said({", torque: 100}": "}", ", torque: 50}": "}"})
        ),
        lambda b: b.tested(robot_file=b.said({", torque: 100}": "}", ", torque: 50}": "}"})),
    ),
    "idle-joints": (
        lambda b: b.found(*b.single_joint_runs(), preprocess=PreprocessChoices(keep_rest=True)),
        lambda b: b.found(*b.single_joint_runs()),
    ),
    "few-equations": (lambda b: b.found(b.recorded(1, 12.0)), lambda b: b.clean()),
    "few-independent-samples": (lambda b: b.drifting(), lambda b: b.clean()),
    "few-blocks": (
        lambda b: b.found(b.recorded(1, 4.5), preprocess=PreprocessChoices(decimate=16)),
        lambda b: b.clean(),
    ),
    "unexcited-parameters": (lambda b: b.found(b.recorded(1, 30.0, (1, 3e-3, 1))), lambda b: b.clean()),
    "insignificant-parameters": (lambda b: b.found(changed(b.recorded(), noisy)), lambda b: b.clean()),
    "few-moves-for-energy": (lambda b: b.found(changed(b.recorded(), noisy), method="power"), lambda b: b.clean()),
    "joints-locked": (
        lambda b: b.found(b.recorded(1, 30.0, (1, 0, 1))),
        lambda b: b.found(b.recorded(1, 30.0, (1, 0, 1)), experiment=ExperimentChoices(locked=("j2",))),
    ),
    "resting-motor-torque": (
        lambda b: b.found(b.recorded(1, 30.0, (1, 0, 1)), experiment=ExperimentChoices(torques_of=("j1", "j2", "j3"))),
        lambda b: b.clean(),
    ),
    "negative-friction": (lambda b: b.opposite(), lambda b: b.clean()),
    "negative-motor-inertia": (
        lambda b: b.found(b.without_motor_torque(), model=ModelChoices(motor_inertia=True)),
        lambda b: b.clean(),
    ),
    "gravity-opposite": (
        lambda b: b.tested(robot_file=b.said({"model:\n": "model:\n  gravity: [0, 0, 9.81]\n"})),
        lambda b: b.clean(),
    ),
    "gravity-direction": (
        lambda b: b.tested(robot_file=b.said({"model:\n": "model:\n  gravity: [0, 9.81, 0]\n"})),
        lambda b: b.clean(),
    ),
    "gravity-missing": (lambda b: b.weightless(), lambda b: b.clean()),
    "torques-opposite": (lambda b: b.tested(changed(b.recorded(), lambda i: -i)), lambda b: b.clean()),
    "positions-opposite": (lambda b: b.tested(changed(b.recorded(), lambda q: -q, "position")), lambda b: b.clean()),
    "torque-sign": (lambda b: b.tested(changed(b.recorded(), lambda i: i * [1, -1, 1])), lambda b: b.clean()),
    "position-sign": (
        lambda b: b.tested(changed(b.recorded(), lambda q: q * [1, 1, -1], "position")),
        lambda b: b.clean(),
    ),
    "joint-sign": (
        lambda b: b.tested(
            changed(changed(b.recorded(), lambda q: q * [1, 1, -1], "position"), lambda i: i * [1, 1, -1])
        ),
        lambda b: b.clean(),
    ),
    "torques-exchanged": (lambda b: b.tested(changed(b.recorded(), exchanged)), lambda b: b.clean()),
    "positions-exchanged": (
        lambda b: b.tested(changed(b.recorded(), lambda q: q[:, [1, 0, 2]], "position")),
        lambda b: b.clean(),
    ),
    "joints-exchanged": (
        lambda b: b.tested(changed(changed(b.recorded(), lambda q: q[:, [0, 2, 1]], "position"), exchanged)),
        lambda b: b.clean(),
    ),
    "sign-or-column": (lambda b: b.opposite(), lambda b: b.clean()),
    "unsigned-torque": (
        lambda b: b.tested(changed(b.recorded(), lambda i: np.where([0, 1, 0], -np.abs(i), i))),
        lambda b: b.clean(),
    ),
    "position-unit": (lambda b: b.names(changed(b.recorded(), np.rad2deg, "position")), lambda b: b.clean_names()),
    "joint-zero": (
        lambda b: b.tested(changed(b.recorded(), lambda q: q + np.deg2rad([0, 8, 0]), "position")),
        lambda b: b.clean(),
    ),
    "position-ripple": (
        lambda b: b.tested(changed(b.recorded(), lambda q: q + [0.0, 5e-3, 0.0] * np.sin(12 * q), "position")),
        lambda b: b.clean(),
    ),
    "position-late": (lambda b: b.late(), lambda b: b.all_late()),
    "inconsistent-gain": (lambda b: b.tested(changed(b.recorded(), lambda i: i * [1, 1, 1.6])), lambda b: b.clean()),
    "lengths-unchecked": (lambda b: b.tested(b.recorded(1, 30.0, (1, 0, 0))), lambda b: b.clean()),
    "wrong-gain": (lambda b: b.tested(changed(b.recorded(), lambda i: i * [1, 1, 20])), lambda b: b.clean()),
    "other-size": (lambda b: b.of_another_size(1.25), lambda b: b.clean()),
    "position-scaled": (
        lambda b: b.tested(
            changed(changed(b.recorded(), lambda q: q * [1, 2, 1], "position"), lambda i: i * [1, 0.5, 1])
        ),
        lambda b: b.clean(),
    ),
    "time-reversed": (
        lambda b: b.tested(changed(changed(b.recorded(), lambda q: q[::-1], "position"), lambda i: i[::-1])),
        lambda b: b.clean(),
    ),
    "torque-shifted": (
        lambda b: b.tested(changed(b.recorded(), lambda i: np.where([0, 1, 0], np.roll(i, 100, axis=0), i))),
        lambda b: b.late(),
    ),
    "motors-coupled": (lambda b: b.tested(changed(b.recorded(), coupled)), lambda b: b.clean()),
    "inconsistent-length": (
        lambda b: b.tested(robot_file=b.said({"alpha: 0, d: 0.4, r: 0.1": "alpha: 0, d: 0.45, r: 0.1"})),
        lambda b: b.clean(),
    ),
    "friction-near-reversals": (lambda b: b.found(b.sticking()), lambda b: b.found(b.sticking(), **SEARCHED)),
    "indefinite-inertia": (lambda b: b.opposite(), lambda b: b.clean()),
    "residuals-curved": (
        lambda b: b.found(b.with_stribeck()),
        lambda b: b.clean() | b.found(b.with_stribeck(), **SEARCHED),
    ),
    "friction-changes": (
        lambda b: b.found(b.warming()),
        lambda b: b.clean() | b.found(changed(b.recorded(), lambda i: i * np.linspace(1.0, 1.2, len(i))[:, None])),
    ),
    "residuals-autocorrelated": (lambda b: b.drifting(), lambda b: b.clean()),
    "residuals-uneven": (lambda b: b.found(b.with_uneven_noise()), lambda b: b.clean()),
    "residuals-not-normal": (lambda b: b.found(changed(b.recorded(), bursts)), lambda b: b.clean()),
    "overfitting": (lambda b: b.found(changed(b.recorded(), spoilt_end)), lambda b: b.clean()),
    "recordings-differ": (
        lambda b: b.found(b.recorded(), validation=(changed(b.recorded(3), lambda i: i * np.array([1.0, 1.5, 1.0])),)),
        lambda b: b.validated(),
    ),
    "not-held-out": (
        lambda b: b.found(b.recorded(), validation=(b.tail(b.recorded(), b.recorded(3)),)),
        lambda b: b.validated(),
    ),
    "not-validated": (lambda b: b.clean_merge(), lambda b: b.merged(*b.parts(), held_out=b.recorded(3))),
    "contradicting-models": (
        lambda b: b.merged(
            b.whole(),
            b.result(
                simulate_recording(
                    with_load(b.arm, 0.5, (0.3, 0.0, 0.0), (1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3)),
                    random_fourier_motion(build_model(b.arm), PERIOD, 4, candidates=3),
                    30.0,
                    4,
                )
            ),
        ),
        lambda b: b.clean_merge(),
    ),
    "partial-model": (
        lambda b: b.merged(b.parts()[0], b.result(b.recorded(5, shares=(1, 1, 0)), locked=("j3",))),
        lambda b: b.clean_merge(),
    ),
    "checks-of-a-part": (lambda b: b.merged(b.whole(), b.result(b.recorded(4, 12.0))), lambda b: b.clean_merge()),
    "export-diverges": (
        lambda b: in_simulation(exported(b.arm), damping="-300"),
        lambda b: in_simulation(exported(b.arm)),
    ),
    "export-gains-energy": (
        lambda b: in_simulation(exported(b.arm), damping="-0.5", friction="0"),
        lambda b: in_simulation(exported(b.arm), damping="0", friction="0"),
    ),
    "export-loses-motion": (
        lambda b: in_mujoco(exported(b.said({"torque: 100}": "torque: 0.5}", "torque: 50}": "torque: 0.5}"}))),
        lambda b: in_mujoco(exported(b.arm)),
    ),
    "export-not-read": (lambda b: without_mujoco(exported(b.arm)), lambda b: in_mujoco(exported(b.arm))),
}
"""Name → what raises it, what does not."""


@pytest.fixture(scope="module")
def bench(three_joint: RobotFile) -> Bench:
    return Bench(three_joint)


@pytest.mark.parametrize("name", CATALOGUE)
def test_each_check_is_raised_where_it_should_and_nowhere_else(bench: Bench, name: str) -> None:
    raising, silent = CASES[name]
    assert name in raising(bench)
    assert name not in silent(bench)


def test_a_zero_of_the_last_joint_shows_beside_the_urdf_alone(bench: Bench) -> None:
    assert "joint-zero" in beside_its_urdf(bench, turn=8.0)
    assert "joint-zero" not in beside_its_urdf(bench)
    assert "joint-zero" not in bench.found(
        changed(bench.recorded(), lambda q: q + np.deg2rad([0.0, 0.0, 8.0]), "position")
    )


def test_a_sound_recording_raises_nothing(bench: Bench) -> None:
    assert bench.clean() == frozenset()
    assert bench.clean_info() == frozenset()
    assert bench.clean_merge() == {"not-validated"}
