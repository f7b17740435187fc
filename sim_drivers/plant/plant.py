"""The simulated arm: rigid bodies, friction, drives, heat, controller and sensors, advanced in virtual time.

Leapfrog (velocity Verlet) with one articulated-body evaluation per step. Position, velocity, acceleration and drive
torque of one instant belong together: to second order in the step, the torque is the inverse dynamics of the motion.

State, friction and controller are the motors', referred to the joint side. They are the joints', but where the robot
file couples motors; there targets and measurements are converted by q_motor = R·q_joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.loops import coupling_matrix
from daq.robot.schema import TruthJoint
from drivers.core.arrays import FloatArray
from drivers.core.errors import RobotFileError
from ident.model.dynamic_model import build_model
from ident.model.dynamics.rigid_arm import RigidArm, rigid_arm
from ident.model.true_parameters import truth_vector
from sim_drivers.plant.altered_arm import with_load
from sim_drivers.plant.contact import Contacts
from sim_drivers.plant.control import Braking, ComputedTorque, JointController, Pid, Reference, independent_inertia
from sim_drivers.plant.friction import (
    JointHeat,
    PairFriction,
    SimulatedFriction,
    bristle_stiffness,
    copper_losses,
    friction_parameters,
    steepest_slope,
)
from sim_drivers.plant.sensors import EncoderSpeed, Measurement, TorqueSensor, drive_gains, quantised

POSTURES = 20
"""Random postures at which inertias are evaluated, for gains and numerical stability."""

JAMMED_INERTIA = 1e9
"""Inertia [kg·m²] of a jammed joint."""

COLDEST = -100.0
"""Lowest temperature [°C] that is simulated."""

STIFF_STEP = 0.2
"""Step × decay rate of viscous friction from which on it is integrated implicitly."""


@dataclass(frozen=True)
class PlantSettings:
    """How the arm is simulated and controlled; its parameters are in its robot file's truth."""

    step: float = 1e-3  # of the integration [s]
    control_steps: int = 2  # steps a control period; 2 steps of 1 ms give 500 Hz
    heat_steps: int = 20  # steps between two updates of the temperatures
    # "pid" or "computed-torque"; "none" leaves the drives without torque
    controller: Literal["pid", "computed-torque", "none"] = "pid"
    bandwidth: float = 50.0  # of the position loop, ω [rad/s]
    velocity_filter: float = 1e-3  # time constant of the drives' velocity [s]
    nominal_share: float = 1.0  # inertial and friction parameters that the controller believes in, over the true ones

    def __post_init__(self) -> None:
        if not 0.0 < self.step <= 0.01 or self.control_steps < 1 or self.heat_steps < 1:
            raise ValueError(f"impossible step sizes: {self}")
        if self.bandwidth <= 0.0 or self.velocity_filter < 0.0 or self.nominal_share < 0.0:
            raise ValueError(f"impossible controller settings: {self}")


class Plant:
    """An arm that does not exist.

    Args:
        robot_file: with a truth.
        settings: of the simulation.
        seed: of every random number; equal seeds and equal calls give equal arms.
        position: (n,) of the joints at the start [rad or m]; the middle of their ranges where None.

    Attributes:
        robot: the robot file's content.
        settings: as given.
        position, velocity, acceleration: (n,) the motors' true state, joint side [rad, rad/s, rad/s² or m…].
        drive_torque: (n,) true torque of the drives, joint side [N·m].
        friction_torque: (n,) true friction of the motors, counted positive against a positive velocity [N·m].
        thermal: winding and housing temperatures.
        contacts: what touches the arm; `contacts.request` takes more.

    Raises:
        RobotFileError: the truth names no link for some joint, or a link without inertia.
        ValueError: `position` has another shape or is not finite.
    """

    def __init__(
        self,
        robot_file: RobotFile,
        settings: PlantSettings = PlantSettings(),
        seed: int = 0,
        position: FloatArray | None = None,
    ) -> None:
        self.robot, self.settings = robot_file.robot, settings
        robot = self.robot
        model = build_model(robot_file)
        self._robot_file, self._model = robot_file, model
        self.contacts = Contacts(robot_file, model)
        inertial = truth_vector(robot_file)[: 10 * len(model.joints)]
        joints = [robot.truth.joints.get(name, TruthJoint()) for name in robot.joint_names]
        self._motor_inertia = np.array([joint.motor_inertia for joint in joints])
        self._pair_inertia = pair_inertia = np.array([joint.pair_inertia for joint in joints])
        self._arm, self._moving_arm = self._loaded_arms(robot_file, self._motor_inertia)
        self._coupling = coupling_matrix(robot.model.coupling, robot.joint_names) if robot.model.coupling else None
        start = np.array([0.5 * sum(joint.position) for joint in robot.joints]) if position is None else position
        self.position = self._to_motors(self._vector(start, "position")).copy()
        self.velocity = np.zeros(robot.dof)
        self.acceleration = np.zeros(robot.dof)
        self.drive_torque = np.zeros(robot.dof)
        self.friction_torque = np.zeros(robot.dof)
        self._steps, self._time_due = 0, 0.0

        inertia, inverse = _inertias(robot_file, self._arm, self._coupling)
        parameters = friction_parameters(robot)
        self._friction = SimulatedFriction(parameters, *bristle_stiffness(parameters, inverse, settings.step))
        self._pair_friction = PairFriction(robot, model)
        slope = steepest_slope(parameters, robot.truth.thermal.ambient)
        self._half_step = 0.5 * settings.step
        self._added_inertia = self._half_step * _implicit_damping(slope, inverse, settings.step)
        self._stiff = bool(np.any(self._added_inertia))
        self._moving_arm.armature = self._motor_inertia + self._added_inertia
        self.thermal = JointHeat(robot.truth.thermal, robot.dof, settings.heat_steps * settings.step)
        self._copper_loss = copper_losses(robot)

        period = settings.control_steps * settings.step
        self._torque_limit = np.array([joint.torque or np.inf for joint in robot.joints])
        share = settings.nominal_share
        nominal = rigid_arm(model, share * inertial, share * self._motor_inertia, share * pair_inertia)
        self._controller: JointController | None = None
        if settings.controller == "pid":
            tuned, largest = independent_inertia(inertia, inverse), np.max(inertia, axis=0)
            self._controller = Pid(nominal, tuned, largest, settings.bandwidth, period, self._torque_limit)
        elif settings.controller == "computed-torque":
            believed = friction_parameters(robot, settings.nominal_share)
            self._controller = ComputedTorque(nominal, believed, settings.bandwidth, period, self._torque_limit)
        self._target = Reference.at_rest(self.position)
        self._pushed = np.full(robot.dof, np.nan)
        self._braking: tuple[Braking, int] | None = None

        self._generator = np.random.default_rng(seed)
        self._resolution = robot.truth.noise.encoder_resolution
        encoder = quantised(self.position, self._resolution)
        self._speed = EncoderSpeed(encoder, period, settings.velocity_filter)
        self._torque_sensor = TorqueSensor(robot, settings.step, self._generator)
        self._gains = drive_gains(robot)
        self._stuck: dict[tuple[str, int], float] = {}
        # Torque meters behind the motor's inertia do not see it (`drives[].inertia`).
        unseen = np.array([not robot.drive(name).inertia for name in robot.joint_names])
        self._unseen_inertia = np.where(unseen, self._motor_inertia, 0.0)
        self._update_conditions()
        self._accelerate(np.zeros(robot.dof), self.velocity)

    @property
    def time(self) -> float:
        """Virtual time since the start [s]."""
        return self._steps * self.settings.step

    def set_target(
        self, position: FloatArray, velocity: FloatArray | None = None, acceleration: FloatArray | None = None
    ) -> None:
        """Set the controller's reference from its next period on, (n,) each; ends a stop.

        Raises:
            ValueError: another shape, or a value that is not finite.
        """
        zeros = np.zeros(self.robot.dof)
        self._target = Reference(
            self._to_motors(self._vector(position, "position")).copy(),
            zeros if velocity is None else self._to_motors(self._vector(velocity, "velocity")).copy(),
            zeros if acceleration is None else self._to_motors(self._vector(acceleration, "acceleration")).copy(),
        )
        self._braking = None

    def halt(self, deceleration: float | FloatArray) -> None:
        """Bring every motor to rest from its present velocity at this deceleration [rad/s²], then hold.

        Raises:
            ValueError: a deceleration that is not positive.
        """
        rates = np.broadcast_to(np.asarray(deceleration, dtype=np.float64), (self.robot.dof,))
        if not np.all(rates > 0.0):
            raise ValueError(f"a deceleration must be positive, not {deceleration}")
        start = Reference(self.position, self.velocity, np.zeros(self.robot.dof))
        self._braking = Braking(start, rates), self._steps

    def push(self, torque: FloatArray) -> None:
        """Let the motors give torques (n,) [N·m] from now on, within their limits; NaN: controlled as before."""
        self._pushed = np.clip(torque, -self._torque_limit, self._torque_limit)

    def limit_torque(self, limit: FloatArray) -> None:
        """Let the motors give no more than (n,) [N·m], and no more than the robot file allows, from now on."""
        if self._controller is not None:
            self._controller.limit_torque(np.minimum(limit, self._torque_limit))

    def advance(self, duration: float) -> None:
        """Simulate this many seconds more, as fast as it runs; fractions of a step add up over calls.

        Raises:
            ValueError: time does not run backwards.
        """
        if not 0.0 <= duration < np.inf:
            raise ValueError(f"cannot advance by {duration} s")
        self._time_due += duration
        settings = self.settings
        for _ in range(round(self._time_due / settings.step) - self._steps):
            if self._steps % settings.control_steps == 0:
                if (grasp := self.contacts.due(self.time)) is not None:
                    self.carry(grasp.mass, grasp.centre)
                self._control()
            self._step()
            self._steps += 1
            if self._steps % settings.control_steps == 0:
                self._speed.add(quantised(self.position, self._resolution))
            if self._steps % settings.heat_steps == 0:
                self._update_heat()

    def measure(self) -> Measurement:
        """The sensors' present values; each call draws its own noise."""
        target = self._target
        torque = self._torque_sensor.read() - self._unseen_inertia * self.acceleration
        measured = Measurement(
            time=self.time,
            position=self._to_joints(quantised(self.position, self._resolution)).copy(),
            velocity=self._to_joints(self._speed.velocity).copy(),
            current=torque / self._gains,
            torque=self._torque_at_joints(torque),
            temperature=quantised(self.thermal.housing, self.robot.truth.noise.temperature_resolution).copy(),
            target_position=self._to_joints(target.position).copy(),
            target_velocity=self._to_joints(target.velocity).copy(),
            target_acceleration=self._to_joints(target.acceleration).copy(),
            target_current=self.drive_torque / self._gains,
            model_torque=lambda: self._torque_at_joints(
                self._arm.inverse(target.position, target.velocity, target.acceleration)
            ),
        )
        for (quantity, joint), value in self._stuck.items():
            getattr(measured, quantity)[joint] = value
        return measured

    def heat(self, joint: int, celsius: float) -> None:
        """Raise the temperature of winding and housing of the joint of this index at once, by `celsius` [K].

        Raises:
            ValueError: no such joint, or a housing colder than -100 °C.
        """
        self._check_joint(joint)
        if not COLDEST <= self.thermal.housing[joint] + celsius < np.inf:
            raise ValueError(f"no joint works {celsius} K above {self.thermal.housing[joint]} °C")
        self.thermal.winding[joint] += celsius
        self.thermal.housing[joint] += celsius
        self._update_conditions()

    def carry(self, mass: float, centre: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        """Carry a point mass [kg] on the tool from now on, its centre [m] from the tool point; nothing where it is 0.

        The controller does not know of it.

        Raises:
            RobotFileError: the file has no true link there.
        """
        loaded = with_load(self._robot_file, mass, centre, [0.0] * 6) if mass > 0.0 else self._robot_file
        self._arm, self._moving_arm = self._loaded_arms(loaded, self._moving_arm.armature)

    def _loaded_arms(self, robot_file: RobotFile, armature: FloatArray) -> tuple[RigidArm, RigidArm]:
        """The arm, and the one that the integration moves."""
        inertial = truth_vector(robot_file)[: 10 * len(self._model.joints)]
        true, moving = (
            rigid_arm(self._model, inertial, inertia, self._pair_inertia) for inertia in (self._motor_inertia, armature)
        )
        return true, moving

    def block(self, joint: int) -> None:
        """Jam the joint of this index: it stops at once and does not move, whatever its drive does.

        Raises:
            ValueError: no such joint.
        """
        self._check_joint(joint)
        # So much inertia that no drive moves it: the other joints then feel the jam as they would feel a rigid link.
        self._added_inertia[joint] = 0.0
        armature = self._moving_arm.armature.copy()
        armature[joint] = JAMMED_INERTIA
        self._moving_arm.armature = armature
        self.velocity[joint] = self.acceleration[joint] = 0.0

    def stick(self, joint: int, quantity: str) -> None:
        """Let a sensor of the joint of this index hang: what it measures as `quantity` stays what it is.

        Raises:
            ValueError: no such joint.
        """
        self._check_joint(joint)
        self._stuck[quantity, joint] = float(getattr(self.measure(), quantity)[joint])

    def _check_joint(self, joint: int) -> None:
        if not 0 <= joint < self.robot.dof:
            raise ValueError(f"no joint {joint}; there are {self.robot.dof}, the first is 0")

    def _vector(self, values: FloatArray, what: str) -> FloatArray:
        vector = np.asarray(values, dtype=np.float64)
        if vector.shape != (self.robot.dof,) or not np.isfinite(vector).all():
            raise ValueError(f"{what} must be {self.robot.dof} finite numbers, not {values!r}")
        return vector

    def _to_motors(self, values: FloatArray) -> FloatArray:
        return values if self._coupling is None else self._coupling @ values

    def _to_joints(self, values: FloatArray) -> FloatArray:
        return values if self._coupling is None else np.asarray(np.linalg.solve(self._coupling, values))

    def _from_joints(self, torque: FloatArray) -> FloatArray:
        return torque if self._coupling is None else np.asarray(np.linalg.solve(self._coupling.T, torque))

    def _torque_at_joints(self, torque: FloatArray) -> FloatArray:
        return torque if self._coupling is None else np.asarray(self._coupling.T @ torque)

    def _control(self) -> None:
        if self._braking is not None:
            braking, since = self._braking
            self._target = braking.target((self._steps - since) * self.settings.step)
        if self._friction.load_matters:
            self._update_conditions()
        if self._controller is not None:
            encoder = quantised(self.position, self._resolution)
            controlled = self._controller.torque(self._target, encoder, self._speed.velocity)
            self.drive_torque = np.where(np.isnan(self._pushed), controlled, self._pushed)

    def _step(self) -> None:
        kick = self._half_step * self.acceleration
        middle = self.velocity + kick
        travel = self.settings.step * middle
        self.position = self.position + travel
        self._accelerate(travel, middle + kick)
        self.velocity = middle + self._half_step * self.acceleration

    def _accelerate(self, travel: FloatArray, velocity: FloatArray) -> None:
        # `velocity` is a prediction, good to second order. Where viscous friction is stiff for the step, its error is
        # corrected implicitly: (M + D)·a = τ − F(prediction) + D·a_before with D = h/2·slope.
        before = self.acceleration
        friction = self._friction.torque(velocity, travel)
        if self._pair_friction.present:
            friction = friction + self._pair_friction.torque(velocity)
        push = self.drive_torque - friction
        if self.contacts.present:
            joints = self._to_joints(self.position), self._to_joints(velocity)
            push = push + self._from_joints(self.contacts.torque(*joints, self.time))
        if self._stiff:
            push = push + self._added_inertia * before
        acceleration = self._moving_arm.forward(self.position, velocity, push)
        if self._stiff:
            friction = friction + self._added_inertia * (acceleration - before)
        self.acceleration, self.friction_torque = acceleration, friction
        self._torque_sensor.push(self.drive_torque, self.position)

    def _update_heat(self) -> None:
        rubbing = np.maximum(self.friction_torque * self.velocity, 0.0)
        self.thermal.advance(self._copper_loss * self.drive_torque**2, rubbing)
        self._update_conditions()

    def _update_conditions(self) -> None:
        load = self._arm.gravity(self.position) if self._friction.load_matters else 0.0
        self._friction.set_conditions(self.thermal.housing, np.asarray(load))


def _inertias(robot_file: RobotFile, arm: RigidArm, coupling: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Diagonal (K, n) of the inertia matrix of the motors, and its inverse (K, n, n), at random postures."""
    low, high = (np.array(limit) for limit in zip(*(j.position for j in robot_file.robot.joints), strict=True))
    # A seed of its own: the choice of postures is no part of the plant's randomness.
    postures = np.random.default_rng(0).uniform(low, high, (POSTURES, len(low)))
    if coupling is not None:
        postures = postures @ coupling.T
    matrices = np.array([arm.inertia(posture) for posture in postures])
    if np.min(np.linalg.eigvalsh(matrices)) <= 1e-9:
        raise RobotFileError(
            "a joint moves no inertia, so that its acceleration is undefined",
            where=f"{robot_file.robot.name}: truth",
            hint="give every link an inertia or every joint a motor_inertia",
        )
    return np.diagonal(matrices, axis1=1, axis2=2), np.linalg.inv(matrices)


def _implicit_damping(slope: FloatArray, inverse_inertias: FloatArray, step: float) -> FloatArray:
    """Slope (n,) of friction over velocity where it is stiff for the step, else zeros."""
    root = np.sqrt(slope)
    fastest = float(np.max(np.linalg.eigvalsh(root[:, None] * inverse_inertias * root)))
    return slope if step * fastest > STIFF_STEP else np.zeros_like(slope)
