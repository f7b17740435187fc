"""Arrays that become a recording: their shapes, their stamps, and whether they look like SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from daq.recording.counter_stamps import counter_range
from daq.recording.unit_plausibility import DEGREES, displacement_ratios, near, other_unit
from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError
from drivers.core.ranges import SAMPLING_RATE
from drivers.core.text import counted

WHERE = "Recording.from_arrays"


@dataclass(frozen=True)
class JointArrays:
    """Checked arrays: `time` (N,) [s], strictly rising; `values` quantity → (N, n), units as in `drivers.streams`."""

    time: FloatArray
    values: Mapping[str, FloatArray]


def joint_arrays(robot_file: RobotFile, time: npt.ArrayLike, given: Mapping[str, npt.ArrayLike | None]) -> JointArrays:
    """Check arrays (N, n) of joint signals in the robot's order, by quantity, with their stamps (N,) [s].

    What was not recorded is None; `position` must be there.

    Raises:
        DataError: names the array, the sample and the joint, and what to do.
    """
    arrays = _arrays("time", time, given, robot_file.robot.joint_names)
    rate = 1.0 / float(np.median(np.diff(arrays.time)))
    if not SAMPLING_RATE.holds(rate):
        units = {unit: rate * factor for unit, factor in (("ms", 1e3), ("µs", 1e6), ("ns", 1e9))}
        fitting = next((unit for unit, there in units.items() if SAMPLING_RATE.holds(there)), None)
        hint = f"the stamps look like {fitting}; give seconds" if fitting else "give seconds"
        raise _refusal("time", f"{rate:.4g} samples per second is not a plausible rate for a robot arm", hint)
    _check_units(robot_file, arrays.time, arrays.values)
    return arrays


def command_arrays(
    robot_file: RobotFile, target_time: npt.ArrayLike, given: Mapping[str, npt.ArrayLike | None]
) -> JointArrays:
    """Check arrays of commands (M, n) with stamps (M,) [s] of their own.

    Raises:
        DataError: names the array, the sample and the joint, and what to do; there are stamps, but no commands.
    """
    if all(array is None for array in given.values()):
        raise _refusal("target_time", "is given without commands", "give target_position")
    return _arrays("target_time", target_time, given, robot_file.robot.joint_names)


def _arrays(
    clock: str, time: npt.ArrayLike, given: Mapping[str, npt.ArrayLike | None], joints: tuple[str, ...]
) -> JointArrays:
    """Arrays of one clock: stamps that rise, and a finite row for each."""
    stamps = _numbers(clock, time)
    if stamps.ndim != 1:
        raise _refusal(clock, f"has shape {stamps.shape}; (N,) is needed")
    if len(stamps) < 2:
        raise _refusal(clock, f"holds {counted(len(stamps), 'sample')}; at least 2 are needed")
    values = {}
    for quantity, array in given.items():
        if array is not None:
            _check_columns(quantity, array, joints)
            values[quantity] = _checked(quantity, _numbers(quantity, array), len(stamps), joints)
    _check_time(clock, stamps)
    return JointArrays(stamps, values)


def _refusal(name: str, message: str, hint: str = "") -> DataError:
    return DataError(message, where=f"{WHERE}: {name}", hint=hint)


def _check_columns(name: str, values: npt.ArrayLike, joints: tuple[str, ...]) -> None:
    """Refuse a data frame that names the joints in another order, which its numbers alone would not show."""
    columns = [str(column) for column in getattr(values, "columns", ())]
    if columns != list(joints) and sorted(columns) == sorted(joints):
        raise _refusal(
            name,
            f"has the columns {', '.join(columns)}; the joints' order is {', '.join(joints)}",
            f"give {name}[{list(joints)}]",
        )


def _numbers(name: str, values: npt.ArrayLike) -> FloatArray:
    if isinstance(values, np.ma.MaskedArray):  # what is masked is no measurement
        values = np.ma.filled(values.astype(np.float64), np.nan)
    try:
        numbers = np.array(values)
        if not np.iscomplexobj(numbers):
            return numbers.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise _refusal(name, "does not consist of numbers in equal rows") from error
    except RuntimeError as error:  # a tensor with a gradient
        raise _refusal(name, "does not consist of numbers", str(error).partition("\n")[0]) from error
    raise _refusal(name, "holds complex numbers", f"give {name}.real")


def _checked(name: str, values: FloatArray, count: int, joints: tuple[str, ...]) -> FloatArray:
    expected = (count, len(joints))
    if len(joints) == 1 and values.shape == (count,):
        values = values[:, None]
    if values.shape != expected:
        if values.shape == expected[::-1]:
            hint = f"it is transposed: give {name}.T, time first, joints last"
        else:
            hint = f"one row per sample, one column per joint: {', '.join(joints)}"
        raise _refusal(name, f"has shape {values.shape}; {expected} is needed", hint)
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        samples = len(np.unique(bad[:, 0]))
        raise _refusal(
            name,
            f"{samples} of {count} samples have NaN or infinite values, first sample {bad[0, 0]}, joint "
            f"{joints[bad[0, 1]]}",
            "leave these samples out of all arrays; the gap in time is recognised",
        )
    return values


def _check_time(clock: str, time: FloatArray) -> None:
    bad = np.flatnonzero(~np.isfinite(time))
    if len(bad):
        raise _refusal(clock, f"is not finite at sample {bad[0]}")
    steps = np.diff(time)
    wrong = np.flatnonzero(steps <= 0)
    if len(wrong):
        first = int(wrong[0]) + 1
        repeats = steps[wrong[0]] == 0
        raise _refusal(
            clock,
            f"{'repeats the stamp before' if repeats else 'goes backward'} at sample {first} ({time[first]:.9g} s), "
            f"{len(wrong)} times in all",
            _remedy(time, first, repeats),
        )


def _remedy(time: FloatArray, sample: int, repeats: bool) -> str:
    """Return what to do about a stamp that does not rise."""
    if repeats:
        return "keep the first of each"
    range_of_counter = counter_range(time, sample)
    if range_of_counter is not None:
        return f"the counter restarted: add its range of {range_of_counter:.6g} s from there on"
    return "sort all arrays by time, or give each run as its own recording"


def _check_units(robot_file: RobotFile, time: FloatArray, values: Mapping[str, FloatArray]) -> None:
    position = values["position"]
    for limits, column in zip(robot_file.robot.joints, position.T, strict=True):
        unit = other_unit(time, column, limits)
        if unit is not None:
            raise _refusal(
                "position",
                f"reaches {np.abs(column).max():.4g} {limits.unit('rad')} at joint {limits.name}, whose "
                f"limits are {list(limits.position)} and {limits.velocity:g} per second: these are {unit}",
                {"mm": "give metres", "degrees": "give numpy.deg2rad(position)"}.get(unit, "give rad (or m)"),
            )
    if "velocity" not in values:
        return
    ratios = displacement_ratios(time, position, values["velocity"])
    for limits, ratio in zip(robot_file.robot.joints, ratios, strict=True):
        name = limits.name
        if ratio is None or limits.sliding:
            continue
        for expected, wrong, other in ((DEGREES, "position", "velocity"), (1 / DEGREES, "velocity", "position")):
            if near(ratio, expected):
                message = f"of joint {name} looks like degrees beside the {other}"
                raise _refusal(wrong, message, f"give numpy.deg2rad({wrong})")
