"""A simulated arm of position-controlled servos: what a position command becomes, step by step.

Joint j, with duty d, share s of the supply's nominal voltage, winding and housing ΔW and ΔH above the ambient air:

    e = goal − encoder − bias, less the dead band        d = clip(stiffness·e / torque_limit, ±1)
    drive τ = c/r·s·torque_limit·d                       c = 1 + torque_slope·ΔW,  r = 1 + resistance_slope·ΔW
    back-EMF and derivative gain: (c²/r·torque_limit/no_load_speed + gain_d)·q̇
    friction: viscous·(1 + viscous_slope·ΔH)·q̇, and dry: coulomb + load_friction·|τ| + stribeck·exp(−(q̇/v_s)²)

A servo without `no_load_speed` controls its current: r and s do not matter, and there is no back-EMF. The voltage
sags by the current that the duty cycles draw. Where a joint has play, motor and joint are two bodies, which a stiff
gear holds together at its ends; the encoder is the joint's. Each step solves all bodies together to its middle,
implicitly in stiffness and damping, with dry friction exact (`ident.simulation.dry_friction`), and goes on from there
with the velocity of the middle: of an implicit step to the end, so much damping and inertia would be the step's own
that an underdamped servo's truth would not be its own. A wall that it touches is solved together with them.
"""

from __future__ import annotations

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.schema import Robot, TruthJoint, TruthServo, TruthSupply
from drivers.core.arrays import FloatArray
from drivers.core.errors import RobotFileError
from ident.compiled.library import kernels
from ident.model.dynamics.rigid_arm import rigid_arm
from ident.model.true_parameters import true_model, truth_vector
from ident.simulation.dry_friction import quick_dry_friction
from sim_drivers.plant.altered_arm import with_load
from sim_drivers.plant.contact import Contacts
from sim_drivers.plant.friction import JointHeat

STEP = 0.002
"""[s] of an arm without play."""

STEP_WITH_PLAY = 0.001
"""[s] of an arm with play."""

HEATING_STEPS = 50
"""Steps between two changes of temperatures."""

JAMMED = 1e4
"""Dry friction [N·m] of a jammed joint."""

GEAR_DAMPING = 0.5
"""Damping ratio of a gear at the end of its play."""


def true_servos(robot: Robot, where: str) -> list[TruthServo]:
    """The servo of every joint.

    Raises:
        RobotFileError: a joint has none.
    """
    servos = [robot.truth.joints.get(name, TruthJoint()).servo for name in robot.joint_names]
    without = [name for name, servo in zip(robot.joint_names, servos, strict=True) if servo is None]
    if without:
        raise RobotFileError(
            f"no servo for {', '.join(without)}",
            where=f"{where}: truth.joints",
            hint="give each joint one: servo: {stiffness: …, torque_limit: …}, as docs/robot-file.md has it",
        )
    return [servo for servo in servos if servo is not None]


class ServoArm:
    """State of a simulated servo arm; arrays (n,), joint side.

    It stands at `position` [rad or m] at first; windings and housings have `celsius`, the truth's ambient temperature
    where None.

    Attributes:
        step: of `advance` [s].
        torque: (n,) of the drives in the last step [N·m or N].
        current: (n,) of the motors in the last step, with its sign; 0 without a `stall_current` [A].
        heat: temperatures of windings and housings.
        supply: share of the nominal voltage.
        effort: (n,) largest share of the full duty cycle, 0 where a servo is limp.
        push: (n,) what the drives are to add to their position loops [N·m or N].
        contacts: what touches the arm, in the time of its steps; `contacts.request` takes more.
    """

    def __init__(self, file: RobotFile, position: FloatArray, celsius: float | None = None) -> None:
        robot = file.robot
        servos = true_servos(robot, file.where)
        truths = [robot.truth.joints[name] for name in robot.joint_names]
        self._supply = robot.truth.supply or TruthSupply(nominal=1.0, voltage=1.0)

        def of(name: str) -> FloatArray:
            return np.array([getattr(servo, name) for servo in servos], dtype=np.float64)

        def joint(name: str) -> FloatArray:
            return np.array([getattr(truth, name) for truth in truths], dtype=np.float64)

        self._stiffness, self._limit, self._bias = of("stiffness"), of("torque_limit"), of("bias")
        self._dead_band, self._encoder, self._stall = of("dead_band"), of("encoder_step"), of("stall_current")
        self._voltage = np.array([servo.no_load_speed is not None for servo in servos])
        self._back = np.array([0.0 if s.no_load_speed is None else s.torque_limit / s.no_load_speed for s in servos])
        self._gain_d, self._share, self._behind = of("gain_d"), of("load_friction"), of("joint_friction")
        self._slopes = of("resistance_slope"), of("torque_slope"), of("viscous_slope")
        self._viscous, self._coulomb = joint("viscous"), joint("coulomb")
        self._breakaway, self._fading = joint("stribeck"), joint("stribeck_velocity")
        # A loop that sees steps, or a joint behind play, does not see the motor move within a step.
        self._in_steps = (self._encoder > 0) | (of("backlash") > 0)
        self._implicit = np.where(self._in_steps, 0.0, self._stiffness)
        armature = joint("motor_inertia")
        play = of("backlash")
        count, self._loose = len(servos), np.flatnonzero(play > 0)
        self._half_play, self._gear = play[self._loose] / 2, of("gear_stiffness")[self._loose]
        self._rotor = armature[self._loose]
        self._gear_damping = 2.0 * GEAR_DAMPING * np.sqrt(self._gear * self._rotor)
        self._driven = np.arange(count)
        self._driven[self._loose] = count + np.arange(len(self._loose))
        model = true_model(file)
        inertial = truth_vector(file, model)[: 10 * len(model.joints)]
        armature[self._loose] = 0.0
        self._file, self._model, self._armature = file, model, armature
        self._arm = rigid_arm(model, inertial, armature)
        self.contacts = Contacts(file, model)
        self.step = STEP_WITH_PLAY if len(self._loose) else STEP
        self._dof = count
        self._bodies = np.concatenate([position, position[self._loose]])
        self._rates = np.zeros(len(self._bodies))
        self._guess = np.zeros(len(self._bodies))
        self.torque, self.current, self.effort = np.zeros(count), np.zeros(count), np.ones(count)
        self.push = np.zeros(count)
        self.supply = self._supply.voltage / self._supply.nominal
        self.heat = JointHeat(robot.truth.thermal, count, HEATING_STEPS * self.step)
        if celsius is not None:
            self.heat.winding[:] = self.heat.housing[:] = celsius
        losses = self._stall * self._supply.nominal / self._limit**2
        given = robot.truth.thermal.copper_loss
        self._copper = np.array([given.get(name, loss) for name, loss in zip(robot.joint_names, losses, strict=True)])
        self._warmth = np.zeros((2, count))
        self._steps = 0
        kernels()  # built, where they do not stand yet, before the arm's clock runs
        self._change_temperature()

    @property
    def position(self) -> FloatArray:
        """(n,) of the joints [rad or m]."""
        return self._bodies[: self._dof]

    @property
    def velocity(self) -> FloatArray:
        """(n,) of the joints [rad/s or m/s]."""
        return self._rates[: self._dof]

    @property
    def motor(self) -> FloatArray:
        """(n,) of the motors, joint side: ahead of the joints by the play at most, and what the gears yield."""
        return self._bodies[self._driven]

    def advance(self, goal: FloatArray) -> None:
        """One step with the means (n,) of the servos' profiles over it, or over equal parts (k, n) of it [rad or m].

        A drive's limit holds for each part: a new goal is not limited as its mean with the one before would be.
        """
        h, n = 0.5 * self.step, self._dof
        position, velocity = self._bodies[:n], self._rates[:n]
        middle = position + h * velocity
        seen = np.where(self._encoder > 0, _quantised(position, self._encoder), middle)
        error = goal - seen - self._bias
        acting = np.abs(error) > self._dead_band
        linear = self._stiffness * np.where(acting, error - np.sign(error) * self._dead_band, 0.0) + self.push
        duty = np.clip(linear / self._limit, -self.effort, self.effort)
        free = acting & (np.abs(duty) < self.effort)
        if goal.ndim > 1:
            duty, free = duty.mean(axis=0), free.mean(axis=0)
        strength = self._strength * np.where(self._voltage, self.supply, 1.0)
        torque = strength * self._limit * duty
        stiffness = strength * self._implicit * free
        matrix = self._matrix(middle)
        momentum = matrix @ self._rates
        momentum[:n] -= h * self._arm.bias(middle, velocity)
        momentum[self._driven] += h * torque
        momentum[:n] += h * h * stiffness * velocity
        diagonal = np.zeros(len(self._rates))
        diagonal[self._driven] += h * (self._damping_now + self._gain_d)
        diagonal[:n] += h * h * stiffness
        matrix.flat[:: len(matrix) + 1] += diagonal
        self._close_play(matrix, momentum)
        self._touch(matrix, momentum)
        response = np.linalg.inv(matrix)
        alone, weights = np.asarray(response @ momentum, dtype=np.float64), np.asarray(h * response, dtype=np.float64)
        limits = self._friction(torque)
        self._guess = quick_dry_friction(weights, alone, limits, self._guess)
        rates = alone - weights @ self._guess
        self._bodies = self._bodies + self.step * rates
        self._rates = np.where(np.abs(self._guess) < limits, 0.0, 2.0 * rates - self._rates)
        self.torque = torque + h * stiffness * (velocity - rates[:n]) - self._back_now * rates[self._driven]
        self.current = self.torque / (self._limit * self._constant) * self._stall
        drawn = float(np.sum(np.maximum(self.current * duty, 0.0)))
        sagging = max(self._supply.voltage - self._supply.resistance * drawn, 0.1 * self._supply.voltage)
        self.supply = sagging / self._supply.nominal
        rubbing = np.abs(self._guess * rates)
        self._warmth += self._copper * (self.torque / self._constant) ** 2, rubbing[self._driven]
        self._steps += 1
        if self._steps % HEATING_STEPS == 0:
            self.heat.advance(self._warmth[0] / HEATING_STEPS * self._resistance, self._warmth[1] / HEATING_STEPS)
            self._warmth[:] = 0.0
            self._change_temperature()

    def set_gains(self, stiffness: FloatArray, gain_d: FloatArray) -> None:
        """Take other gains of the position loops (n,) [N·m/rad] and against velocity (n,) [N·m·s/rad]."""
        self._stiffness, self._gain_d = stiffness, gain_d
        self._implicit = np.where(self._in_steps, 0.0, stiffness)

    def block(self, joint: int) -> None:
        """Jam the joint of this index for good: it brakes harder than its drive can push."""
        self._coulomb[joint] = JAMMED

    def keep_within(self, lowest: FloatArray, highest: FloatArray) -> None:
        """End stops: no joint is, or goes on, beyond positions (n,) [rad or m]."""
        n = self._dof
        beyond = (self._bodies[:n] > highest) & (self._rates[:n] > 0.0) | (self._bodies[:n] < lowest) & (
            self._rates[:n] < 0.0
        )
        if beyond.any():
            self._bodies[:n] = np.clip(self._bodies[:n], lowest, highest)
            self._rates[:n][beyond] = 0.0

    def _matrix(self, position: FloatArray) -> FloatArray:
        """Inertia matrix of joints, and of the motors that have play."""
        inertia = self._arm.inertia(position)
        if not len(self._loose):
            return inertia
        n, count = self._dof, len(self._rates)
        matrix = np.zeros((count, count))
        matrix[:n, :n] = inertia
        matrix[range(n, count), range(n, count)] = self._rotor
        return matrix

    def _close_play(self, matrix: FloatArray, momentum: FloatArray) -> None:
        """Add the gears whose play will be used up in the middle of the step."""
        h, n = 0.5 * self.step, self._dof
        for index, joint in enumerate(self._loose.tolist()):
            motor = n + index
            gap = self._bodies[motor] - self._bodies[joint]
            coming = gap + h * (self._rates[motor] - self._rates[joint])
            if abs(coming) <= self._half_play[index]:
                continue
            beyond = gap - np.copysign(self._half_play[index], coming)
            spring = h * self._gear_damping[index] + h * h * self._gear[index]
            for row, sign in ((motor, 1.0), (joint, -1.0)):
                momentum[row] -= sign * h * self._gear[index] * beyond
                matrix[row, motor] += sign * spring
                matrix[row, joint] -= sign * spring

    def _touch(self, matrix: FloatArray, momentum: FloatArray) -> None:
        """Add what touches the arm; walls, as springs and dampers, in the middle of the step."""
        h, n, time = 0.5 * self.step, self._dof, self._steps * self.step
        if (grasp := self.contacts.due(time)) is not None:
            loaded = with_load(self._file, grasp.mass, grasp.centre, [0.0] * 6) if grasp.mass > 0.0 else self._file
            inertial = truth_vector(loaded, self._model)[: 10 * len(self._model.joints)]
            self._arm = rigid_arm(self._model, inertial, self._armature)
        if not self.contacts.present:
            return
        push, pressed = self.contacts.acting(self._bodies[:n], time)
        momentum[:n] += h * push
        for wall, lever, depth in pressed:
            leaving = float(lever @ self._rates[:n])
            if wall.stiffness * (depth - h * leaving) > wall.damping * leaving:  # a wall does not pull
                momentum[:n] += h * wall.stiffness * depth * lever
                matrix[:n, :n] += h * (wall.damping + h * wall.stiffness) * np.outer(lever, lever)

    def _friction(self, torque: FloatArray) -> FloatArray:
        """Dry friction (bodies,) [N·m]."""
        rates = self._rates[self._driven]
        breakaway = self._breakaway * np.exp(-((rates / self._fading) ** 2))
        limits = np.zeros(len(self._rates))
        limits[self._driven] = self._coulomb + self._share * np.abs(torque) + breakaway
        behind = self._behind[self._loose] * self._coulomb[self._loose]
        limits[self._driven[self._loose]] -= behind
        limits[self._loose] = behind
        return np.maximum(limits, 1e-9)

    def _change_temperature(self) -> None:
        winding, housing = self.heat.winding - self.heat.ambient, self.heat.housing - self.heat.ambient
        resistance, constant, viscous = self._slopes
        self._resistance = np.maximum(1.0 + resistance * winding, 0.1)
        self._constant = np.maximum(1.0 + constant * winding, 0.1)
        loss = np.where(self._voltage, self._resistance, 1.0)
        self._strength = self._constant / loss
        self._back_now = self._constant**2 / loss * self._back
        self._damping_now = self._back_now + self._viscous * np.maximum(1.0 + viscous * housing, 0.0)


def _quantised(values: FloatArray, steps: FloatArray) -> FloatArray:
    """Values (n,) rounded to their own steps; where a step is 0 the result is not used."""
    return np.asarray(np.rint(values / np.where(steps > 0, steps, 1.0)) * steps)
