"""Every check of the catalogue: a recording (or a model) that raises it, and one that does not."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import numpy as np
import pytest
from exported_arms import exported_arm
from lift import LIFT

from daq.recording.recording import COMMANDS_STREAM, HAND_GUIDED, JOINTS_STREAM, Channel, Event, Recording, Stream
from daq.robot.loader import RobotFile, parse_robot
from drivers.core.errors import ModelError
from ident.assessment.recording_checks import recording_checks
from ident.checks.recording_check import recording_info
from ident.experiments.merge.merged_result import merge_results
from ident.export import mujoco_reading, pinocchio_reading
from ident.export.arm import ExportedArm
from ident.export.export import export_mjcf
from ident.export.reading import simulation_checks
from ident.export.urdf import new_urdf
from ident.identify.identification import IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.identify.summary import summarise
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.regression import least_squares
from ident.regression.options import ExperimentChoices
from ident.result.schema import Result
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
    with_velocity,
)

PERIOD = 10.0
SEARCHED = {"model": ModelChoices(), "presliding": True}
NARROW = "known: {Fv1: {max: 2}}\ndrives:\n"
Names = frozenset[str]


def changed(recording: Recording, change: Callable[[np.ndarray], np.ndarray], quantity: str = "current") -> Recording:
    """The recording with other values (N, n) of one quantity."""
    stream = recording.streams[JOINTS_STREAM]
    channel = stream.channels[quantity]
    channels = dict(stream.channels) | {quantity: replace(channel, values=change(channel.values.copy()))}
    return replace(recording, streams={JOINTS_STREAM: replace(stream, channels=channels)})


def late(position: np.ndarray) -> np.ndarray:
    """Positions (N, n), the second joint's of 80 ms before."""
    return np.column_stack([position[:, 0], np.roll(position[:, 1], 8), position[:, 2]])


def stamped(recording: Recording, change: Callable[[np.ndarray], np.ndarray]) -> Recording:
    """The recording with other stamps (N,)."""
    stream = recording.streams[JOINTS_STREAM]
    time = change(stream.time.copy())
    return replace(recording, streams={JOINTS_STREAM: replace(stream, time=time, host_time=time)})


def cut(recording: Recording, kept: np.ndarray) -> Recording:
    """Some of the samples."""
    stream = recording.streams[JOINTS_STREAM]
    channels = {name: replace(channel, values=channel.values[kept]) for name, channel in stream.channels.items()}
    stream = replace(stream, time=stream.time[kept], host_time=stream.host_time[kept], channels=channels)
    return replace(recording, streams={JOINTS_STREAM: stream})


class Bench:
    """Recordings of one simulated arm, and what is found wrong with them; each is made once."""

    def __init__(self, arm: RobotFile) -> None:
        self.arm = arm
        self.recorded = cache(self._recorded)
        self.clean = cache(lambda: self.simulated(**SEARCHED))
        self.clean_info = cache(lambda: self.info(self.recorded()))
        self.parts = cache(self._parts)
        self.opposite = cache(lambda: self.found(changed(self.recorded(), lambda i: i * [-1, 1, 1])))
        self.in_a_narrow_range = cache(lambda: self.found(robot_file=self.said({"drives:\n": NARROW})))
        self.whole = cache(lambda: self.result(self.recorded()))
        self.clean_merge = cache(lambda: self.merged(self.whole(), self.result(self.recorded(4))))

    def _recorded(
        self, seed: int = 1, seconds: float = 30.0, shares: tuple[float, ...] = (1, 1, 1), at: float = 0.4
    ) -> Recording:
        """Joint k moves with a share of the usual amplitude."""
        motion = random_fourier_motion(build_model(self.arm), PERIOD, seed, candidates=3)
        for joint, share in enumerate(shares):
            motion.sine[joint] *= share
            motion.cosine[joint] *= share
            motion.offset[joint] = motion.offset[joint] if share == 1 else at
        return simulate_recording(self.arm, motion, seconds, seed)

    def said(self, replacements: dict[str, str]) -> RobotFile:
        """The robot file with other lines."""
        text = self.arm.text
        for old, new in replacements.items():
            assert old in text
            text = text.replace(old, new)
        return parse_robot(text, where="said", folder=None)

    def of_another_size(self, factor: float) -> Names:
        """An arm with a further length, identified with all lengths of its file multiplied by a factor."""
        rows = (("alpha: pi/2, d: 0, r: 0", 0.3, 0.0), ("alpha: 0, d: 0.4, r: 0.1", 0.4, 0.1))
        files = []
        for scale in (1.0, factor):
            words = {row: f"{row.split(', d')[0]}, d: {scale * d}, r: {scale * r}" for row, d, r in rows}
            files.append(self.said(words))
        arm, believed = files
        motion = random_fourier_motion(build_model(arm), PERIOD, 1, candidates=3)
        return self.found(simulate_recording(arm, motion, 20.0, 1), robot_file=believed)

    def names(self, recording: Recording) -> Names:
        """Checks of a recording alone."""
        return frozenset(check.name for check in recording_checks(recording))

    def info(self, recording: Recording) -> Names:
        """Checks of `dynid info`."""
        return frozenset(check.name for check in recording_info(recording, self.arm).verdict.checks)

    def found(
        self,
        *recordings: Recording,
        robot_file: RobotFile | None = None,
        validation: tuple[Recording, ...] = (),
        **options: object,
    ) -> Names:
        """Checks of an identification; what takes half of its time is left out: searches, and the simulated motion."""
        with (
            patch("ident.identify.held_out.track_longest", return_value=(None, "left out by this test")),
            patch("ident.identify.held_out.open_loop", return_value=None),
        ):
            return self.simulated(*recordings, robot_file=robot_file, validation=validation, **options)

    def simulated(
        self,
        *recordings: Recording,
        robot_file: RobotFile | None = None,
        validation: tuple[Recording, ...] = (),
        **options: object,
    ) -> Names:
        """The same with the simulated motion."""
        plain = {"search_delay": False, "presliding": False, "model": ModelChoices(friction="coulomb-viscous")}
        choices = IdentifyChoices(**(plain | options))
        used = recordings or (self.recorded(),)
        return frozenset(check.name for check in identify(used, validation, choices, robot_file).checks)

    def result(self, recording: Recording, **experiment: tuple[str, ...]) -> Result:
        """What `identify` writes."""
        choices = IdentifyChoices(search_delay=False, presliding=False, experiment=ExperimentChoices(**experiment))
        return summarise(identify([recording], [], choices), [recording], [])

    def merged(self, *results: Result, held_out: Recording | None = None) -> Names:
        """Checks of a merge."""
        result, _ = merge_results([(f"part {i}", part) for i, part in enumerate(results)], held_out)
        return frozenset(check.name for check in result.verdict.checks)

    def _parts(self) -> tuple[Result, Result]:
        """Joint 3 locked; joint 3's own torque."""
        arm = self.result(self.recorded(1, shares=(1, 1, 0)), locked=("j3",))
        return arm, self.result(self.recorded(2), torques_of=("j3",))

    def single_joint_runs(self) -> list[Recording]:
        """One joint after the other, the others held by static friction."""
        generator = np.random.default_rng(1)
        runs = []
        for moving in range(3):
            shares = tuple(float(joint == moving) for joint in range(3))
            held = generator.uniform(-1.0, 1.0, 3) * np.array([0.6, 0.9, 0.5])  # [A], within the Coulomb friction
            held[moving] = 0.0
            runs.append(changed(self.recorded(10 + moving, 12.0, shares), lambda values, held=held: values + held))
        return runs

    def with_velocity(self, gains: tuple[float, ...] = (1.0, 1.0, 1.0)) -> Recording:
        """With a recorded velocity, each joint's times a factor."""
        recording = self.recorded()
        stream = recording.streams[JOINTS_STREAM]
        position = stream.channels["position"]
        speed = np.gradient(position.values, stream.time, axis=0) * gains
        channels = {**stream.channels, "velocity": Channel("velocity", speed, "rad/s", position.columns)}
        return replace(recording, streams={JOINTS_STREAM: replace(stream, channels=channels)})

    def drifting_clock(self) -> Recording:
        """Stamps whose clock goes wrong by 1 % beside the host's."""
        recording = self.recorded()
        stream = recording.streams[JOINTS_STREAM]
        return replace(recording, streams={JOINTS_STREAM: replace(stream, host_time=1.01 * stream.time)})

    def tail(self, recording: Recording, other: Recording) -> Recording:
        """Another recording whose last third is copied from the first."""
        copied = recording.streams[JOINTS_STREAM].channels
        start = 2 * len(other.streams[JOINTS_STREAM].time) // 3
        for quantity in ("position", "current"):
            values = copied[quantity].values[start:]
            other = changed(other, lambda own, values=values: np.concatenate([own[:start], values]), quantity)
        return other

    def unsettled(self) -> Names:
        """Weights that are given two iterations."""
        with patch.object(least_squares, "WLS_ITERATIONS", 2):
            return self.found()

    def inconsistent(self) -> Names:
        """A search for consistent parameters that reaches no minimum."""
        with patch("ident.identify.identify.found_consistent", return_value=None):
            return self.found()

    def diverging(self) -> Names:
        """A model whose simulated motion diverges."""
        error = ModelError("the simulated motion diverges at 1.2 s")
        with patch("ident.simulation.tracking.tracking_error", side_effect=error):
            return self.simulated()

    def sticking(self, *recorded: object) -> Recording:
        """Friction that sticks at reversals."""
        recording = self.recorded(*recorded)
        stream = recording.streams[JOINTS_STREAM]
        speed = np.gradient(stream.channels["position"].values, stream.time, axis=0)
        slow = np.abs(speed) < 0.1 * np.sqrt(np.mean(speed**2, axis=0))
        return changed(recording, lambda i: i - np.where(slow, 0.3 * np.abs(i).mean(axis=0) * np.sign(speed), 0.0))

    def without_motor_torque(self) -> Recording:
        """A torque from which more than the motors' inertia torque was taken away."""
        recording = self.recorded()
        stream = recording.streams[JOINTS_STREAM]
        step = stream.time[1] - stream.time[0]
        kernel = np.hanning(41) / np.hanning(41).sum()
        position = stream.channels["position"].values
        smooth = np.array([np.convolve(column, kernel, mode="same") for column in position.T]).T
        acceleration = np.gradient(np.gradient(smooth, step, axis=0), step, axis=0)
        acceleration[:100] = acceleration[-100:] = 0.0
        return changed(recording, lambda i: i - 2.5 * acceleration / np.array([10.0, -8.0, 4.0]))

    def with_stribeck(self) -> Recording:
        """Friction that grows towards standstill, as no column of the model does."""
        return changed(
            self.recorded(), lambda i: i + 0.3 * np.sign(self.speed()) * np.exp(-((self.speed() / 0.3) ** 2))
        )

    def with_uneven_noise(self) -> Recording:
        """Noise that grows with velocity."""
        noise = np.random.default_rng(3).standard_normal(self.speed().shape)
        return changed(self.recorded(), lambda i: i + 0.5 * np.abs(self.speed()) * noise)

    def speed(self) -> np.ndarray:
        """(N, n) of the recorded motion [rad/s]."""
        stream = self.recorded().streams[JOINTS_STREAM]
        return np.gradient(stream.channels["position"].values, stream.time, axis=0)


def shifted_from_the_middle(size: float) -> Callable[[np.ndarray], np.ndarray]:
    """The second joint's position another one from the middle on."""
    return lambda q: q + size * np.outer(np.arange(len(q)) >= len(q) // 2, [0.0, 1.0, 0.0])


def without_rows(recording: Recording, start: int, stop: int) -> Recording:
    """The recording without some rows, whose stamps go on."""
    stream = recording.streams[JOINTS_STREAM]
    rows = np.r_[0:start, stop : len(stream.time)]
    channels = {name: replace(channel, values=channel.values[rows]) for name, channel in stream.channels.items()}
    time = stream.time[: len(rows)]
    stream = replace(stream, time=time, host_time=time, channels=channels)
    return replace(recording, streams={**recording.streams, JOINTS_STREAM: stream})


def taken_for(recording: Recording, quantity: str, other: str, factor: float) -> Recording:
    """The recording with another quantity's values in a quantity's columns."""
    values = recording.streams[JOINTS_STREAM].channels[other].values
    return changed(recording, lambda _: factor * values, quantity)


def exchanged_with_velocity(recording: Recording) -> Recording:
    """The recording with the second joint's position and velocity in each other's columns."""
    channels = recording.streams[JOINTS_STREAM].channels
    q, v, second = channels["position"].values, channels["velocity"].values, np.array([False, True, False])
    found = changed(recording, lambda _: np.where(second, v, q), "position")
    return changed(found, lambda _: np.where(second, q, v), "velocity")


def servo(
    recording: Recording,
    told: Callable[[np.ndarray], np.ndarray] = lambda values: values,
    late: float = 0.0,
    last: float = np.inf,
) -> Recording:
    """Without its current, but with commands at 50 Hz that the positions follow after 60 ms.

    Args:
        recording: of the motion.
        told: changes the commands (M, n).
        late: by which their stamps are wrong [s].
        last: of their stamps [s].
    """
    joints = recording.streams[JOINTS_STREAM]
    position = joints.channels["position"]
    stamps = np.arange(0.0, min(joints.time[-1], last), 0.02)
    values = np.column_stack([np.interp(stamps + 0.06, joints.time, column) for column in position.values.T])
    channels = {"target_position": Channel("target_position", told(values), "rad", position.columns)}
    streams = {
        JOINTS_STREAM: replace(joints, channels={"position": position}),
        COMMANDS_STREAM: Stream(COMMANDS_STREAM, stamps + late, stamps + late, channels),
    }
    return replace(recording, streams=streams)


def at_rest(recording: Recording, joint: int) -> Recording:
    """One joint stands still."""
    return changed(recording, lambda q: np.where(np.arange(3) == joint, q[0], q), "position")


def glitches(share: float) -> Callable[[np.ndarray], np.ndarray]:
    """Encoder glitches of 0.05 rad, spread over some of the samples."""

    def change(values: np.ndarray) -> np.ndarray:
        generator = np.random.default_rng(2)
        return values + 0.05 * (generator.random(values.shape) < share)

    return change


def exchanged(values: np.ndarray) -> np.ndarray:
    """Torques of joints 2 and 3 exchanged: in N·m, gains -8 and 4."""
    return values[:, [0, 2, 1]] * np.array([1.0, -0.5, -2.0])


def coupled(values: np.ndarray) -> np.ndarray:
    """Currents of motors, of which the second turns with joint 1, too: Γ1 − Γ2 in the place of Γ1."""
    return values - values[:, [1]] * np.array([-0.8, 0.0, 0.0])


def noisy(values: np.ndarray) -> np.ndarray:
    """A current with much noise."""
    return values + 40.0 * np.random.default_rng(1).standard_normal(values.shape)


def drifting(values: np.ndarray) -> np.ndarray:
    """A current that drifts slowly, as no model does."""
    return values + 3.0 * np.sin(np.linspace(0.0, 7.0, len(values)))[:, None]


def bursts(values: np.ndarray) -> np.ndarray:
    """A current that is now and then off for 0.1 s."""
    generator = np.random.default_rng(4)
    size = 1.5 * generator.standard_normal((300, 3)) * (generator.random((300, 3)) < 0.02)
    return values + np.repeat(size, 20, axis=0)


def spoilt_end(values: np.ndarray) -> np.ndarray:
    """A held-out part that nothing explains."""
    values[int(0.75 * len(values)) :] += 3.0
    return values


def exported(robot_file: RobotFile) -> ExportedArm:
    """The true arm."""
    return exported_arm(robot_file, truth_vector(robot_file))


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


def without_mujoco(arm: ExportedArm) -> Names:
    """The same where MuJoCo is not installed."""
    with patch.object(mujoco_reading, "mujoco_installed", lambda: False):
        return mjcf_checks(arm)


def mjcf_checks(arm: ExportedArm) -> Names:
    with TemporaryDirectory() as folder:
        return frozenset(check.name for check in export_mjcf(arm, Path(folder) / "arm.xml").checks)


CASES: dict[str, tuple[Callable[[Bench], Names], Callable[[Bench], Names]]] = {
    "recording-not-closed": (lambda b: b.names(replace(b.recorded(), complete=False)), lambda b: b.names(b.recorded())),
    "wrong-time-axis": (
        lambda b: b.names(stamped(b.with_velocity(), lambda t: 1.25 * t)),
        lambda b: b.names(b.with_velocity()),
    ),
    "velocity-scale": (lambda b: b.names(b.with_velocity((1.0, 1.0, 0.5))), lambda b: b.names(b.with_velocity())),
    "clocks-drift": (lambda b: b.names(b.drifting_clock()), lambda b: b.names(b.recorded())),
    "torque-ahead": (
        lambda b: b.found(changed(b.recorded(), lambda i: np.roll(i, -2, axis=0)), search_delay=True),
        lambda b: b.found(changed(b.recorded(), lambda i: np.roll(i, 2, axis=0)), search_delay=True),
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
    "implausible-mass": (lambda b: b.found(changed(b.recorded(), lambda i: 0.01 * i)), lambda b: b.clean()),
    "implausible-link": (lambda b: b.found(changed(b.recorded(), lambda i: 200 * i)), lambda b: b.clean()),
    "implausible-centre": (
        lambda b: b.found(robot_file=b.said({"r: 0.3": "r: 0.03", "d: 0.4, r: 0.1": "d: 0.04, r: 0.01"})),
        lambda b: b.clean(),
    ),
    "known-contradicts-data": (
        lambda b: b.in_a_narrow_range(),
        lambda b: b.found(robot_file=b.said({"drives:\n": "known: {Fv1: {max: 9}, M3: 2}\ndrives:\n"})),
    ),
    "weight-not-separate": (
        lambda b: b.found(simulate_recording(LIFT, random_fourier_motion(build_model(LIFT), PERIOD, 1), PERIOD, 1)),
        lambda b: b.clean(),
    ),
    "consistency-rejected": (lambda b: b.opposite(), lambda b: b.clean()),
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
    "samples-lost": (lambda b: b.names(cut(b.recorded(), np.r_[0:1000, 1100:6000])), lambda b: b.names(b.recorded())),
    "repeated-stamps": (
        lambda b: b.names(stamped(b.recorded(), lambda t: np.r_[t[:1000], t[999], t[1001:]])),
        lambda b: b.names(b.recorded()),
    ),
    "jittering-stamps": (
        lambda b: b.names(stamped(b.recorded(), lambda t: t + 4e-3 * np.random.default_rng(1).random(len(t)))),
        lambda b: b.names(stamped(b.recorded(), lambda t: t + 2e-4 * np.random.default_rng(1).random(len(t)))),
    ),
    "unsigned-signal": (lambda b: b.names(changed(b.recorded(), np.abs)), lambda b: b.names(b.recorded())),
    "no-torque": (lambda b: b.info(servo(b.recorded())), lambda b: b.clean_info()),
    "positions-alone": (
        lambda b: b.info(replace(servo(b.recorded()), streams={JOINTS_STREAM: servo(b.recorded()).streams["joints"]})),
        lambda b: b.info(servo(b.recorded())),
    ),
    "commands-short": (lambda b: b.info(servo(b.recorded(), last=25.0)), lambda b: b.info(servo(b.recorded()))),
    "command-clock": (
        lambda b: b.info(servo(b.recorded(), late=0.3)),
        lambda b: b.info(servo(b.recorded(), late=-0.1)),
    ),
    "command-order": (
        lambda b: b.info(servo(b.recorded(), lambda q: q[:, [0, 2, 1]])) & b.info(servo(b.recorded(), np.negative)),
        lambda b: b.info(servo(b.recorded())),
    ),
    "command-unit": (lambda b: b.info(servo(b.recorded(), np.rad2deg)), lambda b: b.info(servo(b.recorded()))),
    "joint-at-rest": (lambda b: b.info(servo(at_rest(b.recorded(), 1))), lambda b: b.info(servo(b.recorded()))),
    "signal-clipped": (
        lambda b: b.names(changed(b.recorded(), lambda i: np.clip(i, -0.5 * i.max(axis=0), 0.5 * i.max(axis=0)))),
        lambda b: b.names(b.recorded()),
    ),
    "outliers-replaced": (
        lambda b: b.info(changed(b.recorded(), glitches(1e-3), "position")),
        lambda b: b.clean_info(),
    ),
    "many-outliers": (
        lambda b: b.found(changed(b.recorded(), glitches(0.04), "position")),
        lambda b: b.found(changed(b.recorded(), glitches(1e-3), "position")),
    ),
    "rows-repeated": (lambda b: b.names(repeated_rows(b.recorded(), 0.1, 1)), lambda b: b.names(b.recorded())),
    "encoder-stuck": (
        lambda b: (
            b.names(stuck_encoder(with_velocity(b.recorded()), 1, 3.0, 1.0))
            & b.names(stuck_encoder(servo(b.recorded()), 1, 3.0, 1.0))
            & b.info(stuck_encoder(servo(b.recorded()), 1, -1.0, 40.0))
        ),
        lambda b: b.names(with_velocity(b.recorded())),
    ),
    "position-jump": (
        lambda b: b.names(changed(b.recorded(), shifted_from_the_middle(0.2), "position")),
        lambda b: b.names(b.recorded()),
    ),
    "position-wraps": (
        lambda b: b.names(changed(b.recorded(), shifted_from_the_middle(2.0 * np.pi), "position")),
        lambda b: b.names(changed(b.recorded(), shifted_from_the_middle(0.2), "position")),
    ),
    "rows-missing": (
        lambda b: b.names(without_rows(b.recorded(), 600, 900)),
        lambda b: b.names(changed(b.recorded(), shifted_from_the_middle(0.2), "position")),
    ),
    "motion-as-torque": (
        lambda b: b.names(taken_for(with_velocity(b.recorded()), "current", "velocity", 180.0 / np.pi)),
        lambda b: b.names(with_velocity(b.recorded())),
    ),
    "steady-torque": (
        lambda b: b.names(changed(b.recorded(), lambda i: 30.0 + np.arange(len(i))[:, None] * [1e-3, 2e-3, 1e-3])),
        lambda b: b.names(b.recorded()),
    ),
    "same-column": (
        lambda b: b.names(changed(b.recorded(), lambda i: i[:, [0, 1, 0]])),
        lambda b: b.names(b.recorded()),
    ),
    "position-velocity-exchanged": (
        lambda b: b.names(exchanged_with_velocity(with_velocity(b.recorded()))),
        lambda b: b.names(with_velocity(b.recorded())),
    ),
    "recording-changes": (
        lambda b: b.found(changed(b.recorded(), lambda i: i * np.linspace([1.0] * 3, [1.0, 1.2, 1.0], len(i)))),
        lambda b: b.clean(),
    ),
    "filled-with-zeros": (lambda b: b.names(filled_with_zeros(b.recorded(), 0.5, 1)), lambda b: b.names(b.recorded())),
    "positions-jitter": (lambda b: b.found(jittering_position(b.recorded(), 0.02, 1)), lambda b: b.clean()),
    "residual-bursts": (lambda b: b.found(contact(b.recorded(), 0.05, 1.0, 1)), lambda b: b.clean()),
    "few-parameters-determined": (
        lambda b: b.info(changed(b.recorded(1, 4.5, (0.02, 0.02, 0.02)), noisy)),
        lambda b: b.clean_info(),
    ),
    "no-motion": (
        lambda b: b.info(changed(b.recorded(), lambda q: np.zeros_like(q), "position")),
        lambda b: b.clean_info(),
    ),
    "high-condition": (lambda b: b.info(b.recorded(1, 30.0, (1, 0.02, 1))), lambda b: b.clean_info()),
    "slow-motion": (lambda b: b.info(b.recorded(1, 30.0, (0.1, 0.1, 0.1))), lambda b: b.clean_info()),
    "torque-beyond-limits": (lambda b: b.info(changed(b.recorded(), lambda i: 1e3 * i)), lambda b: b.clean_info()),
    "torque-far-below-limits": (lambda b: b.found(changed(b.recorded(), lambda i: 1e-3 * i)), lambda b: b.clean()),
    "implausible-load": (
        lambda b: b.found(
            changed(b.recorded(), lambda i: 1e3 * i), robot_file=b.said({", torque: 100}": "}", ", torque: 50}": "}"})
        ),
        lambda b: b.found(robot_file=b.said({", torque: 100}": "}", ", torque: 50}": "}"})),
    ),
    "idle-joints": (
        lambda b: b.found(*b.single_joint_runs(), preprocess=PreprocessChoices(keep_rest=True)),
        lambda b: b.found(*b.single_joint_runs()),
    ),
    "few-equations": (lambda b: b.found(b.recorded(1, 12.0)), lambda b: b.clean()),
    "few-independent-samples": (lambda b: b.found(changed(b.recorded(), drifting)), lambda b: b.clean()),
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
        lambda b: b.found(robot_file=b.said({"model:\n": "model:\n  gravity: [0, 0, 9.81]\n"})),
        lambda b: b.clean(),
    ),
    "gravity-direction": (
        lambda b: b.found(robot_file=b.said({"model:\n": "model:\n  gravity: [0, 9.81, 0]\n"})),
        lambda b: b.clean(),
    ),
    "torques-opposite": (lambda b: b.found(changed(b.recorded(), lambda i: -i)), lambda b: b.clean()),
    "positions-opposite": (lambda b: b.found(changed(b.recorded(), lambda q: -q, "position")), lambda b: b.clean()),
    "torque-sign": (lambda b: b.found(changed(b.recorded(), lambda i: i * [1, -1, 1])), lambda b: b.clean()),
    "position-sign": (
        lambda b: b.found(changed(b.recorded(), lambda q: q * [1, 1, -1], "position")),
        lambda b: b.clean(),
    ),
    "joint-sign": (
        lambda b: b.found(
            changed(changed(b.recorded(), lambda q: q * [1, 1, -1], "position"), lambda i: i * [1, 1, -1])
        ),
        lambda b: b.clean(),
    ),
    "torques-exchanged": (lambda b: b.found(changed(b.recorded(), exchanged)), lambda b: b.clean()),
    "positions-exchanged": (
        lambda b: b.found(changed(b.recorded(), lambda q: q[:, [1, 0, 2]], "position")),
        lambda b: b.clean(),
    ),
    "joints-exchanged": (
        lambda b: b.found(changed(changed(b.recorded(), lambda q: q[:, [0, 2, 1]], "position"), exchanged)),
        lambda b: b.clean(),
    ),
    "sign-or-column": (lambda b: b.opposite(), lambda b: b.clean()),
    "unsigned-torque": (
        lambda b: b.found(changed(b.recorded(), lambda i: np.where([0, 1, 0], -np.abs(i), i))),
        lambda b: b.clean(),
    ),
    "position-unit": (
        lambda b: b.names(changed(b.recorded(), np.rad2deg, "position")),
        lambda b: b.names(b.recorded()),
    ),
    "joint-zero": (
        lambda b: b.found(changed(b.recorded(), lambda q: q + np.deg2rad([0, 8, 0]), "position")),
        lambda b: b.clean(),
    ),
    "position-late": (lambda b: b.found(changed(b.recorded(), late, "position")), lambda b: b.clean()),
    "inconsistent-gain": (lambda b: b.found(changed(b.recorded(), lambda i: i * [1, 1, 1.6])), lambda b: b.clean()),
    "lengths-unchecked": (lambda b: b.found(b.recorded(1, 30.0, (1, 0, 0))), lambda b: b.clean()),
    "wrong-gain": (lambda b: b.found(changed(b.recorded(), lambda i: i * [1, 1, 20])), lambda b: b.clean()),
    "other-size": (lambda b: b.of_another_size(1.25), lambda b: b.clean()),
    "motors-coupled": (lambda b: b.found(changed(b.recorded(), coupled)), lambda b: b.clean()),
    "inconsistent-length": (
        lambda b: b.found(robot_file=b.said({"alpha: 0, d: 0.4, r: 0.1": "alpha: 0, d: 0.45, r: 0.1"})),
        lambda b: b.clean(),
    ),
    "friction-near-reversals": (lambda b: b.found(b.sticking()), lambda b: b.found(b.sticking(), **SEARCHED)),
    "indefinite-inertia": (lambda b: b.opposite(), lambda b: b.clean()),
    "residuals-curved": (
        lambda b: b.found(b.with_stribeck()),
        lambda b: b.clean() | b.found(b.with_stribeck(), **SEARCHED),
    ),
    "residuals-autocorrelated": (lambda b: b.found(changed(b.recorded(), drifting)), lambda b: b.clean()),
    "residuals-uneven": (lambda b: b.found(b.with_uneven_noise()), lambda b: b.clean()),
    "residuals-not-normal": (lambda b: b.found(changed(b.recorded(), bursts)), lambda b: b.clean()),
    "overfitting": (lambda b: b.found(changed(b.recorded(), spoilt_end)), lambda b: b.clean()),
    "recordings-differ": (
        lambda b: b.found(b.recorded(), validation=(changed(b.recorded(3), lambda i: i * np.array([1.0, 1.5, 1.0])),)),
        lambda b: b.found(b.recorded(), validation=(b.recorded(3),)),
    ),
    "not-held-out": (
        lambda b: b.found(b.recorded(), validation=(b.tail(b.recorded(), b.recorded(3)),)),
        lambda b: b.found(b.recorded(), validation=(b.recorded(3),)),
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


def test_a_sound_recording_raises_nothing(bench: Bench) -> None:
    assert bench.clean() == frozenset()
    assert bench.clean_info() == frozenset()
    assert bench.clean_merge() == {"not-validated"}
