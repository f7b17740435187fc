"""One table of ranges: what is finite but absurd is refused in one line, without a warning before it."""

from __future__ import annotations

import warnings
from dataclasses import fields, replace

import numpy as np
import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

import ident.ranges
import ident.tasks.options
from daq.recording.recording import Recording
from daq.robot.loader import load_robot, parse_robot
from drivers.core import ranges
from drivers.core.errors import DataError, RobotFileError, UsageError
from drivers.core.options import Options, declared
from drivers.core.ranges import Range, check_option
from ident.excite.choices import DesignChoices
from ident.excite.design import build_problem
from ident.identify.identification import IdentifyChoices
from ident.model.load import KnownLoad
from ident.result.consistent_model import LinkResult
from ident.result.estimate import EstimateResult
from ident.signals.options import PreprocessChoices
from ident.signals.resampling import check_stamps, measure_irregularity
from ident.tasks.options import InfoOptions
from ident.tasks.recording_quality import info

DECLARED = {
    f"{options.__name__}.{of.name}": stated.allowed
    for options in vars(ident.tasks.options).values()
    if isinstance(options, type) and issubclass(options, Options) and options is not Options
    for of in fields(options)  # type: ignore[arg-type]
    if (stated := declared(of)) is not None and stated.allowed is not None
}
TABLE = DECLARED | {
    name: value for name, value in (vars(ranges) | vars(ident.ranges)).items() if isinstance(value, Range)
}
UR5E = load_robot("ur5e")


def test_every_range_holds_its_ends_and_no_number_that_is_none() -> None:
    outside = (float("nan"), float("inf"), -float("inf"), 1e308)
    assert [
        name for name, allowed in TABLE.items() if not (allowed.holds(allowed.least) and allowed.holds(allowed.most))
    ] == []
    assert [name for name, allowed in TABLE.items() if any(map(allowed.holds, outside))] == []


@given(st.floats(), st.sampled_from(sorted(TABLE)))
def test_any_option_is_taken_or_refused_in_one_line(value: float, name: str) -> None:
    if TABLE[name].holds(value):
        check_option("--option", value, TABLE[name])
        return
    with pytest.raises(UsageError) as caught:
        check_option("--option", value, TABLE[name])
    assert "is not within" in str(caught.value)
    assert "\n" not in str(caught.value)


def design(**choices: float) -> None:
    build_problem(UR5E, None, DesignChoices(**choices))  # type: ignore[arg-type]  # refused before the prior is used


OPTIONS = {
    "cut-off": lambda: PreprocessChoices(position_cutoff=1e-8),
    "torque cut-off": lambda: PreprocessChoices(torque_cutoff=1e308),
    "decimate": lambda: PreprocessChoices(decimate=10**9),
    "position decimate": lambda: PreprocessChoices(position_decimate=10**9),
    "delay": lambda: PreprocessChoices(delay=1e308),
    "joint delay": lambda: PreprocessChoices(joint_delays=(0.0, 1e308)),
    "start": lambda: PreprocessChoices(start=1e308),
    "rest velocity": lambda: PreprocessChoices(rest_velocity=1e308),
    "energy window": lambda: IdentifyChoices(method="energy:window=1e-300"),
    "period": lambda: design(period=1e-300),
    "long period": lambda: design(period=1e308),
    "periods": lambda: design(periods=10**9),
    "harmonics": lambda: design(harmonics=10**5),
    "points": lambda: design(points=10**9),
    "ramp": lambda: design(ramp=1e308),
    "mass of a load": lambda: KnownLoad(1e308),
    "centre of mass of a load": lambda: KnownLoad(1.0, (1e308, 0.0, 0.0)),
    "inertia of a load": lambda: KnownLoad(1.0, (0.0, 0.0, 0.0), (1e300, 0.0, 0.0, 1e300, 0.0, 1e300)),
    "wanted RSD": lambda: InfoOptions("run.h5", wanted_rsd=1e-160),
}


@each("name", OPTIONS)
def test_an_absurd_option_is_refused_before_any_work(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(UsageError, match="is not within"):
            OPTIONS[name]()


@each("factor", [1e-12, 1e-300, 1e12])
def test_stamps_of_another_unit_are_refused_without_a_warning(factor: float) -> None:
    def check() -> None:
        time = np.arange(1, 1000) / 500 * factor
        check_stamps(time)
        measure_irregularity(time)

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(DataError, match=r"is not a plausible rate|is not within"):
            check()


@each("factor", [1e-12, 1e-300, 1e12])
def test_info_refuses_stamps_of_another_unit(factor: float) -> None:
    time = np.arange(1, 500) / 500
    position = np.sin(time)[:, None] * np.ones(6)
    recording = Recording.from_arrays(UR5E, time=time, position=position, torque=position)
    joints = recording.streams["joints"]
    scaled = replace(joints, time=joints.time * factor, host_time=joints.host_time * factor)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(DataError, match=r"recording in memory: joints: .* is not a plausible rate"):
            info(replace(recording, streams={"joints": scaled}))


ARM = """\
name: arm
model:
  mdh:
    - {{joint: j1, alpha: 0, d: {d}, r: {r}}}
joints:
  - {{name: j1, position: [-1, 1], velocity: 1, acceleration: {acceleration}, torque: {torque}}}
"""
SENSIBLE = {"d": 0.1, "r": 0.2, "acceleration": 5.0, "torque": 10.0}


@given(st.sampled_from(sorted(SENSIBLE)), st.floats(allow_nan=False, allow_infinity=False))
def test_any_number_of_a_robot_file_is_taken_or_refused(key: str, value: float) -> None:
    text = ARM.format(**SENSIBLE | {key: f"{value:.17e}"})
    try:
        robot = parse_robot(text, where="arm.yaml", folder=None).robot
    except RobotFileError as error:
        refused = str(error)
    else:
        assert robot.model.mdh is not None
        assert abs(robot.model.mdh[0].d) <= 100.0
        assert robot.joints[0].torque is not None
        assert 1e-12 <= robot.joints[0].torque <= 1e9
        return
    assert refused.startswith("arm.yaml: ")
    assert "\n" not in refused


@each("key", SENSIBLE)
@each("value", ["1e200", "1e308", "9" * 5000])
def test_an_absurd_number_of_a_robot_file_is_named(key: str, value: str) -> None:
    with pytest.raises(RobotFileError, match=r"is not within|cannot read the number"):
        parse_robot(ARM.format(**SENSIBLE | {key: value}), where="arm.yaml", folder=None)


def test_values_of_a_result_are_bounded() -> None:
    link = {"link": "j1", "mass": 1e308, "com": [0, 0, 0], "inertia": {}, "prior": "", "identified": 1.0}
    with pytest.raises(ValidationError, match="is not within"):
        LinkResult.model_validate(link)
    with pytest.raises(ValidationError, match="at least 3 items"):
        LinkResult.model_validate(link | {"mass": 1.0, "com": [0, 0]})
    estimate = {"parameters": ["a"], "root": [[1e308]], "covariance": [[1.0]], "absorbed": {}, "blocks": 30}
    with pytest.raises(ValidationError, match="is not within"):
        EstimateResult.model_validate(estimate)
