"""The step of `ident.simulation.time_stepping` by the compiled kernel (ident/compiled/stepping.c)."""

from __future__ import annotations

import ctypes
from contextlib import suppress
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError
from ident.compiled.library import address, kernels
from ident.model.compiled_rows import CompiledTree
from ident.model.kinematics.transmission import LinearTransmission
from ident.simulation.forward_arm import ForwardArm

if TYPE_CHECKING:
    from ident.model.kinematics.linkages.closed_loops import ClosedLoops


class _Loops(ctypes.Structure):
    """`struct loops` of stepping.c."""

    _fields_ = [
        *((name, ctypes.c_int) for name in ("chains", "linear", "equations", "passive")),
        *((name, ctypes.c_void_p) for name in ("chain_from", "chain_rows", "before", "link_joint", "link_prismatic")),
        *((name, ctypes.c_void_p) for name in ("link_sign", "link_axis", "link_after", "coefficients", "right")),
        *((name, ctypes.c_void_p) for name in ("rows", "passive_joint")),
        *((name, ctypes.c_double) for name in ("sign", "step_tolerance", "missed", "branch_distance")),
        ("newton_steps", ctypes.c_int),
    ]


class _Arm(ctypes.Structure):
    """`struct arm` of stepping.c."""

    _fields_ = [
        ("tree", ctypes.POINTER(CompiledTree)),
        ("motors", ctypes.c_int),
        *((name, ctypes.c_void_p) for name in ("active", "inertial", "rotors", "follow", "placed")),
        ("loops", ctypes.POINTER(_Loops)),
    ]


class _Run(ctypes.Structure):
    """`struct run` of stepping.c."""

    _fields_ = [
        *((name, ctypes.c_double) for name in ("step", "precision", "diverged")),
        *((name, ctypes.c_int) for name in ("rounds", "directions")),
        *((name, ctypes.c_void_p) for name in ("position", "velocity", "torque", "viscous", "driving", "steady")),
        *((name, ctypes.c_void_p) for name in ("motion", "limit", "travel", "dry", "change", "state")),
    ]


class CompiledStepping:
    """Steps of one arm along arrays that stay where they are."""

    def __init__(
        self,
        arm: ForwardArm,
        step: float,
        motion: tuple[FloatArray, FloatArray, FloatArray],
        memory: tuple[FloatArray, FloatArray, FloatArray],
        bounds: tuple[float, float, int],
    ) -> None:
        """Prepare the kernel's tables; where there is a library only.

        Args:
            arm: to simulate.
            step: [s].
            motion: positions, velocities and torques, each (N, n), of which the first row of positions is filled.
            memory: dry friction (m,), change of the velocity (n,) and Dahl's states (m,) of the step before.
            bounds: precision and largest velocity, and how often the bias is evaluated at most.

        Raises:
            DataError: a loop does not close at the start.
        """
        model, transmission = arm.model, arm.model.transmission
        self._arm, self._motion, self._change = arm, motion, memory[1]
        self._changing_friction = arm.changing_friction
        self._tree = CompiledTree(model.joints, model.gravity)
        follow = placed = None
        loops = None
        if isinstance(transmission, LinearTransmission):
            if not np.array_equal(transmission.follow, np.eye(len(model.joints))) or transmission.offset.any():
                follow, placed = transmission.follow, transmission.offset
        else:
            loops = cast("ClosedLoops", transmission)
            placed = loops.tree_position(motion[0][0])
            follow = np.zeros((len(model.joints), model.dof))
            follow[list(transmission.active), range(model.dof)] = 1.0
        self._kept: list[np.ndarray[Any, Any]] = []
        self._loops = None if loops is None else self._loops_of(loops)
        self._compiled = _Arm(
            ctypes.pointer(self._tree),
            model.dof,
            self._keep(transmission.active, np.intc),
            self._keep(arm.inertial),
            self._keep(arm.rotors),
            None if follow is None else self._keep(follow.copy()),
            None if placed is None else self._keep(placed.copy()),
            None if self._loops is None else ctypes.pointer(self._loops),
        )
        self._viscous, driving = arm.viscous.copy(), np.zeros(model.dof)
        self._driving, self._steady, self._limits = driving, arm.offset.copy(), arm.dry.copy()
        self._step = step
        precision, diverged, rounds = bounds
        friction = [self._viscous, self._driving, self._steady, np.ascontiguousarray(arm.directions), self._limits]
        friction.append(arm.travel / step)
        self._kept += friction
        self._run = _Run(step, precision, diverged, rounds, len(arm.dry), *map(address, (*motion, *friction, *memory)))
        call = kernels().quick.dynid_step
        call.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int)
        self._call = call
        self._pointers = ctypes.addressof(self._compiled), ctypes.addressof(self._run)

    def done(self, index: int) -> bool:
        """Return whether the step from row `index` was done; what was not needs the step in Python, which says why."""
        if self._changing_friction:
            position, velocity = self._motion[0][index], self._motion[1][index]
            middle = position + 0.5 * self._step * velocity
            self._viscous[:], self._driving[:] = self._arm.viscous_at(velocity + 0.5 * self._change)
            self._limits[:] = self._arm.dry_at(middle, velocity)
            self._steady[:] = self._arm.steady(middle)
        return not self._call(*self._pointers, index)

    def _keep(self, values: object, kind: type = np.float64) -> int:
        """Address of an array (never empty) of these values, which is kept."""
        array: np.ndarray[Any, Any] = np.ascontiguousarray(values, dtype=kind)
        self._kept.append(array)
        return address(array)

    def _loops_of(self, transmission: ClosedLoops) -> _Loops:
        from ident.model.kinematics.linkages import loop_equations as limits

        equations = transmission.equations
        links = [link for chain in equations.chains for link in chain.links]
        return _Loops(
            len(equations.chains),
            len(equations.linear),
            equations.rows.shape[1],
            len(equations.passive),
            self._keep(np.cumsum([0, *(len(chain.links) for chain in equations.chains)]), np.intc),
            self._keep([chain.rows for chain in equations.chains], np.intc),
            self._keep([np.concatenate([chain.before[0].ravel(), chain.before[1]]) for chain in equations.chains]),
            self._keep([link.joint for link in links], np.intc),
            self._keep([link.prismatic for link in links], np.intc),
            self._keep([link.sign for link in links]),
            self._keep([link.axis for link in links]),
            self._keep([np.concatenate([link.after[0].ravel(), link.after[1]]) for link in links]),
            self._keep(equations.linear),
            self._keep(equations.right),
            self._keep(equations.rows),
            self._keep(equations.passive, np.intc),
            equations.sign,
            limits.STEP_TOLERANCE,
            limits.MISSED,
            limits.BRANCH_DISTANCE,
            limits.NEWTON_STEPS,
        )


def compiled_stepping(
    arm: ForwardArm,
    step: float,
    motion: tuple[FloatArray, FloatArray, FloatArray],
    memory: tuple[FloatArray, FloatArray, FloatArray],
    bounds: tuple[float, float, int],
) -> CompiledStepping | None:
    """Steps as of `CompiledStepping`; None without a library, or where a loop does not close at the start."""
    if kernels().quick is None:
        return None
    with suppress(DataError):
        return CompiledStepping(arm, step, motion, memory, bounds)
    return None
