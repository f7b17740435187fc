"""A servo model as a Python configuration of Isaac Lab: actuators, command profile, terms of domain randomisation.

Fields are those of `isaaclab.actuators` and `isaaclab.envs.mdp` of Isaac Lab 2.3; 3.0 still takes their names. Friction
is an effort, as in Isaac Sim 5.0 and later. Isaac Lab is not needed to write a file, and not installed where this is
tested: there, stub classes with the published fields stand for its own.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Mapping, Sequence

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import ModelError
from ident.servo.links import ServoLinks
from ident.servo.ranges import UnitRange, gaussians, unit_ranges
from ident.servo.result import ServoResult
from ident.servo.simulators.actuator_law import ActuatorLaw, FileFormat, actuator_law, left_out
from ident.servo.terms import INDEX, TERMS

PHYSICS_STEP = 0.005
"""[s] in which Isaac Lab's delayed actuators count; `sim.dt` of the environment must be it."""

MISSING = ("load_friction", "load_breakaway", "dead_band", "zero", "backlash")
"""Terms that the file has no place for."""

FORMAT = FileFormat("Isaac Lab's configuration", "the actuators' law", MISSING, PHYSICS_STEP, shaped=True)
"""Profile and bias stand in the file's CommandProfile."""

_PROFILE = '''
class CommandProfile:
    """Shape commands as the servos do, before they become joint targets: call it once per physics step.

    Torch tensors (environments, joints) in the order of JOINTS, or numbers of NumPy.
    """

    def __init__(self, position):
        self.goal, self.speed = position, 0.0 * position

    def __call__(self, command, bias, limit, step=PHYSICS_STEP):
        ahead = command - self.goal
        distance = abs(ahead)
        braking = (2.0 * limit * distance + (0.5 * limit * step) ** 2) ** 0.5 - 0.5 * limit * step
        braking = _least(braking, distance / step)
        wanted = braking * (1.0 * (ahead > 0) - 1.0 * (ahead < 0))
        self.speed = -_least(-_least(wanted, self.speed + limit * step), limit * step - self.speed)
        self.goal = self.goal + step * self.speed
        return self.goal - 0.5 * step * self.speed - bias


def _least(a, b):
    return 0.5 * (a + b - abs(a - b))


def drawn(count, seed=0):
    """Parameters of `count` arms that the recordings allow as well: joint -> parameter -> (count,) values."""
    import numpy

    generator, arms = numpy.random.default_rng(seed), {}
    for joint, of in GAUSSIANS.items():
        points = numpy.array(of["mean"]) + generator.standard_normal((count, len(of["mean"]))) @ numpy.array(
            of["factor"]
        ).reshape(len(of["mean"]), -1).T
        arms[joint] = {
            name: numpy.clip(numpy.exp(points[:, k]) if of["logarithm"][k] else points[:, k], *of["box"][k])
            for k, name in enumerate(of["order"])
        }
    return arms
'''


def isaaclab_configuration(
    result: ServoResult, drives: FloatArray, links: ServoLinks, speeds: FloatArray, unit_spread: float
) -> str:
    """The text of the file.

    Args:
        result: of the identification.
        drives: (n, terms) parameters of the actuators.
        links: of the arm.
        speeds: (n,) limits [rad/s].
        unit_spread: σ of the parameters' logarithms from unit to unit, on top of the recordings' uncertainty.

    Raises:
        ModelError: the arm has loops or coupled motors.
    """
    if not links.model.transmission.direct:
        raise ModelError("closed loops and coupled motors are not exported as servos", where=links.model.name)
    values, names = result.values, result.joints
    law = actuator_law(drives, links, PHYSICS_STEP)
    ranges = unit_ranges(result, unit_spread)
    missing = left_out(values, MISSING)
    lines = [
        # A comment, since a name may hold quotes.
        f"# Servo model of {' '.join(result.robot.split())} for Isaac Lab 2.3 and later (Isaac Sim 5.0), by dynid.",
        "#",
        "# Torques N·m, angles rad, times s. Joints are called as in the robot file. The environment's sim.dt must be",
        "# PHYSICS_STEP: delays are counted in it. Use ACTUATORS in ArticulationCfg(actuators=...), or",
        "# IMPLICIT_ACTUATORS, which have no delay; shape commands with CommandProfile; EVENTS are for an EventCfg.",
        "# Its ranges, and GAUSSIANS, are of "
        + (
            "this arm alone, not of its type."
            if unit_spread == 0
            else f"its type: units differ by {unit_spread:g} (σ of logarithms)."
        ),
        f"# Not in this file: {', '.join(missing) or 'nothing'}.",
        "",
        "from isaaclab.actuators import DelayedPDActuatorCfg, IdealPDActuatorCfg, ImplicitActuatorCfg",
        "from isaaclab.envs import mdp",
        "from isaaclab.managers import EventTermCfg, SceneEntityCfg",
        "",
        f"PHYSICS_STEP = {PHYSICS_STEP}",
        f"JOINTS = {_text(names)}",
        "",
        *_actuators(result, law, speeds, ranges),
        f"COMMAND_BIAS = {_by_joint(names, values[:, INDEX['bias']])}",
        f"ACCELERATION_LIMIT = {_by_joint(names, values[:, INDEX['acceleration_limit']])}",
        "",
        *_events(names, law, ranges),
        f"GAUSSIANS = {_text(gaussians(result, unit_spread))}",
        "",
    ]
    return "\n".join(lines) + "\n" + _PROFILE


def _text(value: object) -> str:
    """The value as a Python literal, whatever characters names hold."""
    return repr(json.loads(json.dumps(value)))


def _pattern(name: str) -> str:
    """The regular expression by which Isaac Lab finds a joint: its name, with special characters escaped."""
    return name if re.fullmatch(r"[\w-]+", name) else re.escape(name)


def _rounded(value: float) -> float:
    return float(f"{value:.9g}")


def _by_joint(names: Sequence[str], column: FloatArray) -> str:
    return _text({name: _rounded(value) for name, value in zip(names, column.tolist(), strict=True)})


def _fields(result: ServoResult, law: ActuatorLaw, speeds: FloatArray, rows: Sequence[int], limit: str) -> list[str]:
    names = [_pattern(result.joints[row]) for row in rows]
    columns = {
        limit: law.effort_limit,
        "velocity_limit_sim": speeds,
        "stiffness": law.stiffness,
        "damping": law.damping,
        "armature": law.armature,
        "friction": law.static,
        "dynamic_friction": law.dynamic,
        "viscous_friction": law.viscous,
    }
    return [
        f"        joint_names_expr={_text(names)},",
        *(
            f"        {field}={_by_joint(names, column[list(rows)])},"
            for field, column in columns.items()
            if np.isfinite(column).all()
        ),
    ]


def _actuators(
    result: ServoResult, law: ActuatorLaw, speeds: FloatArray, ranges: Mapping[str, Mapping[str, UnitRange]]
) -> list[str]:
    groups: dict[tuple[int, int], list[int]] = {}
    for row, name in enumerate(result.joints):
        own, nominal = ranges[name].get("delay"), round(float(law.delay[row]) / PHYSICS_STEP)
        reach = 0 if own is None else round(0.5 * (own.high - own.low) / PHYSICS_STEP)
        reach = min(reach, nominal)
        groups.setdefault((nominal - reach, nominal + reach), []).append(row)
    lines = ["ACTUATORS = {"]
    for (least, most), rows in groups.items():
        delayed = most > 0
        kind = "DelayedPDActuatorCfg" if delayed else "IdealPDActuatorCfg"
        lines.append(f"    {_text('servos_' + str(len(lines)))}: {kind}(")
        lines += _fields(result, law, speeds, rows, "effort_limit")
        lines += [f"        min_delay={least},", f"        max_delay={most},"] if delayed else []
        lines.append("    ),")
    every = range(len(result.joints))
    return [
        *lines,
        "}",
        "IMPLICIT_ACTUATORS = {",
        '    "servos": ImplicitActuatorCfg(',
        *_fields(result, law, speeds, every, "effort_limit_sim"),
        "    ),",
        "}",
        "",
    ]


def _events(names: Sequence[str], law: ActuatorLaw, ranges: Mapping[str, Mapping[str, UnitRange]]) -> list[str]:
    """Terms that scale each joint's parameters within their 95 % boxes."""
    damped = {name: bool(law.damping[row] > 0) for row, name in enumerate(names)}
    terms = (
        ("gains", "randomize_actuator_gains", {"stiffness": "stiffness", "damping": "damping"}),
        ("joint", "randomize_joint_parameters", {"armature": "armature", "friction": "coulomb"}),
    )
    lines = ["EVENTS = {"]
    for name in names:
        for title, function, fields in terms:
            params = {
                f"{field}_distribution_params": (_rounded(own.low / own.value), _rounded(own.high / own.value))
                for field, term in fields.items()
                if (own := ranges[name].get(term)) is not None
                and own.value > 0.0
                and (field != "damping" or damped[name])
            }
            if not params:
                continue
            lines += [
                f"    {_text(f'{title}_{name}')}: EventTermCfg(",
                f"        func=mdp.{function},",
                '        mode="startup",',
                "        params={",
                f'            "asset_cfg": SceneEntityCfg("robot", joint_names=[{_text(_pattern(name))}]),',
                *(f'            "{key}": {pair},' for key, pair in params.items()),
                '            "operation": "scale",',
                '            "distribution": "log_uniform",',
                "        },",
                "    ),",
            ]
    return [*lines, "}", ""]


def read_isaaclab(text: str, where: str) -> ActuatorLaw:
    """The law of the actuators in a file's text.

    Raises:
        ModelError: it is not what `isaaclab_configuration` writes.
    """
    try:
        assigned = {
            target.id: node.value
            for node in ast.parse(text).body
            if isinstance(node, ast.Assign)
            for target in node.targets
            if isinstance(target, ast.Name)
        }
        names = ast.literal_eval(assigned["JOINTS"])
        step = float(ast.literal_eval(assigned["PHYSICS_STEP"]))
        groups = assigned["ACTUATORS"]
        assert isinstance(groups, ast.Dict)
        columns: dict[str, dict[str, float]] = {}
        for call in groups.values:
            assert isinstance(call, ast.Call)
            given = {keyword.arg or "": ast.literal_eval(keyword.value) for keyword in call.keywords}
            delay = step * 0.5 * (given.get("min_delay", 0) + given.get("max_delay", 0))
            given["delay"] = dict.fromkeys(given["joint_names_expr"], delay)
            for field, column in given.items():
                if isinstance(column, dict):
                    columns.setdefault(field, {}).update(column)
    except (SyntaxError, KeyError, ValueError, AssertionError) as error:
        raise ModelError(f"is not a configuration that dynid wrote: {error}", where=where) from error

    def of(field: str, absent: float = 0.0) -> FloatArray:
        return np.array([columns.get(field, {}).get(_pattern(name), absent) for name in names], dtype=np.float64)

    return ActuatorLaw(
        stiffness=of("stiffness"),
        damping=of("damping"),
        viscous=of("viscous_friction"),
        armature=of("armature"),
        static=of("friction"),
        dynamic=of("dynamic_friction"),
        effort_limit=of("effort_limit", TERMS[INDEX["torque_limit"]].absent),
        delay=of("delay"),
    )
