"""Recordings of one simulated arm that raise checks, and what is found wrong with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any
from unittest.mock import patch

import numpy as np
from lift import LIFT

from daq.motion.trajectories import FourierSeries
from daq.recording.recording import COMMANDS_STREAM, JOINTS_STREAM, Channel, Recording, Stream
from daq.robot.loader import RobotFile, parse_robot
from drivers.core.errors import ModelError
from ident.assessment.recording_checks import recording_checks
from ident.checks.recording_check import recording_info
from ident.experiments.merge.merged_result import merge_results
from ident.identify.identification import IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.regression import least_squares
from ident.regression.options import ExperimentChoices
from ident.result.schema import Result
from ident.verdict.catalogue import raised
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.synthetic.data_mistakes import stuck_encoder, with_values, with_velocity

PERIOD = 10.0
SEARCHED = {"model": ModelChoices(), "presliding": True}
NARROW = "known: {Fv1: {max: 2}}\ndrives:\n"
Names = frozenset[str]


def changed(recording: Recording, change: Callable[[np.ndarray], np.ndarray], quantity: str = "current") -> Recording:
    """The recording with other values (N, n) of one quantity."""
    values = recording.streams[JOINTS_STREAM].channels[quantity].values.copy()
    return with_values(recording, **{quantity: change(values)})


def late(position: np.ndarray) -> np.ndarray:
    """Positions (N, n), the second joint's of 80 ms before."""
    return np.column_stack([position[:, 0], np.roll(position[:, 1], 8), position[:, 2]])


def stamped(recording: Recording, change: Callable[[np.ndarray], np.ndarray]) -> Recording:
    """The recording with other stamps (N,)."""
    stream = recording.streams[JOINTS_STREAM]
    time = change(stream.time.copy())
    return replace(recording, streams={JOINTS_STREAM: replace(stream, time=time, host_time=time)})


class Bench:
    """Recordings of one simulated arm, and what is found wrong with them; each is made once."""

    def __init__(self, arm: RobotFile) -> None:
        self.arm = arm
        self.recorded = cache(self._recorded)
        self.clean = cache(lambda: self.simulated(**SEARCHED))
        self.clean_names = cache(lambda: self.names(self.recorded()))
        self.clean_info = cache(lambda: self.info(self.recorded()))
        self.names_with_velocity = cache(lambda: self.names(with_velocity(self.recorded())))
        self.names_of_a_jump = cache(
            lambda: self.names(changed(self.recorded(), shifted_from_the_middle(0.2), "position"))
        )
        self.servo_info = cache(lambda: self.info(servo(self.recorded())))
        self.validated = cache(lambda: self.found(validation=(self.recorded(3),)))
        self.drifting = cache(lambda: self.found(changed(self.recorded(), drifting)))
        self.parts = cache(self._parts)
        self.opposite = cache(lambda: self.tested(changed(self.recorded(), lambda i: i * [-1, 1, 1])))
        self.late = cache(lambda: self.tested(changed(self.recorded(), late, "position")))
        every_position = partial(np.roll, shift=4, axis=0)
        self.all_late = cache(
            lambda: self.tested(changed(self.recorded(), every_position, "position"), search_delay=True)
        )
        self.lift = cache(lambda: self.found(simulate_recording(LIFT, _motion(LIFT), PERIOD, 1)))
        self.stuck = cache(lambda: self.names(stuck_encoder(with_velocity(self.recorded()), 1, 3.0, 1.0)))
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

    def weightless(self) -> Names:
        """An arm that was recorded without gravity, identified with its file's."""
        arm = self.said({"model:\n": "model:\n  gravity: [0, 0, 0]\n"})
        return self.tested(simulate_recording(arm, _motion(arm), 20.0, 1), robot_file=self.arm)

    def of_another_size(self, factor: float) -> Names:
        """An arm with a further length, identified with all lengths of its file multiplied by a factor."""
        rows = (("alpha: pi/2, d: 0, r: 0", 0.3, 0.0), ("alpha: 0, d: 0.4, r: 0.1", 0.4, 0.1))
        files = []
        for scale in (1.0, factor):
            words = {row: f"{row.split(', d')[0]}, d: {scale * d}, r: {scale * r}" for row, d, r in rows}
            files.append(self.said(words))
        arm, believed = files
        motion = random_fourier_motion(build_model(arm), PERIOD, 1, candidates=3)
        return self.tested(simulate_recording(arm, motion, 20.0, 1), robot_file=believed)

    def names(self, recording: Recording) -> Names:
        """Checks of a recording alone."""
        return frozenset(check.name for check in recording_checks(recording))

    def info(self, recording: Recording) -> Names:
        """Checks of `dynid info`."""
        return frozenset(check.name for check in recording_info(recording, self.arm).verdict.checks)

    def found(self, *recordings: Recording, **options: Any) -> Names:
        """Checks of an identification that seeks no mistakes of signs, columns, gains and lengths: half of its time."""
        with patch("ident.identify.checks.checks._mistake_checks", return_value=[]):
            return self.tested(*recordings, **options)

    def late_and_ahead(self) -> Names:
        """Checks of the recording with a late position, where the torque of the whole arm seems to lead."""
        ahead = [raised("torque-ahead", "the torque leads")]
        with patch("ident.identify.checks.checks.delay_checks", return_value=ahead):
            return self.tested(changed(self.recorded(), late, "position"))

    def tested(self, *recordings: Recording, **options: Any) -> Names:
        """Checks of an identification without searches and simulated motion, which take half of the rest."""
        with (
            patch("ident.identify.held_out.track_longest", return_value=(None, "left out by this test")),
            patch("ident.identify.held_out.open_loop", return_value=None),
        ):
            return self.simulated(*recordings, **options)

    def simulated(
        self,
        *recordings: Recording,
        robot_file: RobotFile | None = None,
        validation: tuple[Recording, ...] = (),
        **options: object,
    ) -> Names:
        """Checks of an identification with all that follows it."""
        plain = {"search_delay": False, "presliding": False, "model": ModelChoices(friction="coulomb-viscous")}
        choices = IdentifyChoices(**(plain | options))
        used = recordings or (self.recorded(),)
        return frozenset(check.name for check in identify(used, validation, choices, robot_file).checks)

    def result(self, recording: Recording, **experiment: tuple[str, ...]) -> Result:
        """What `identify` writes."""
        choices = IdentifyChoices(search_delay=False, presliding=False, experiment=ExperimentChoices(**experiment))
        return identify([recording], [], choices).result

    def merged(self, *results: Result, held_out: Recording | None = None) -> Names:
        """Checks of a merge."""
        result, _ = merge_results([(f"part {i}", part) for i, part in enumerate(results)], held_out)
        return frozenset(check.name for check in result.verdict.checks)

    def _parts(self) -> tuple[Result, Result]:
        """Joint 3 locked; joint 3's own torque."""
        arm = self.result(self.recorded(1, shares=(1, 1, 0)), locked=("j3",))
        return arm, self.result(self.recorded(2), torques_of=("j3",))

    def one_way(self) -> Recording:
        """The third joint turns slowly on, at a speed that varies."""
        motion = _motion(self.arm)
        motion.sine[2] *= 0.1
        motion.cosine[2] *= 0.1
        speed = 1.2 * float(np.max(np.abs(motion.evaluate(np.linspace(0.0, PERIOD, 200))[1][2])))
        on = np.array([[0.0], [0.0], [speed]])

        class Turning:
            period = PERIOD

            def evaluate(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
                position, velocity, acceleration = motion.evaluate(time)
                return position + on * time, velocity + on, acceleration

        return simulate_recording(self.arm, Turning(), 15.0, 1)

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
        """Return the recording with a recorded velocity, each joint's times a factor."""
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

    def warming(self) -> Recording:
        """Friction that falls by a third."""
        speed, gain = self.speed(), np.array([10.0, -8.0, 4.0])
        friction = np.sign(speed) * np.array([6.0, 7.0, 2.0]) + speed * np.array([3.0, 4.0, 1.0])
        return changed(self.recorded(), lambda i: i - np.linspace(0.0, 0.33, len(i))[:, None] * friction / gain)

    def speed(self) -> np.ndarray:
        """(N, n) of the recorded motion [rad/s]."""
        stream = self.recorded().streams[JOINTS_STREAM]
        return np.gradient(stream.channels["position"].values, stream.time, axis=0)


def _motion(arm: RobotFile) -> FourierSeries:
    return random_fourier_motion(build_model(arm), PERIOD, 1, candidates=3)


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
