"""Mistakes in real recordings: each is named as what it is, and nothing is named without one."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from each import each

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import RobotFile, load_robot, parse_robot
from drivers.core.arrays import FloatArray
from ident.assessment.file_errors.refit import Refit
from ident.assessment.file_errors.unknowns import Unknown
from ident.assessment.instants import instants
from ident.assessment.mistakes.checks import mistake_checks
from ident.assessment.recording_checks import stale_checks, unit_checks
from ident.assessment.torque_level import torque_level_checks, weight_checks
from ident.estimators.torque_estimator import reduce_torques
from ident.identify.checks.body_checks import with_opposite_torques
from ident.identify.checks.residual_bursts import burst_checks
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.regressor import RegressorKernel
from ident.regression.comparison import compare_torques
from ident.regression.least_squares import weighted_least_squares
from ident.signals.pipeline import PreprocessChoices
from ident.signals.prepared import Segment
from ident.verdict.catalogue import raised
from studies.synthetic.data_mistakes import (
    jittering_position,
    repeated_rows,
    sampled,
    stuck_encoder,
    with_values,
    with_velocity,
)

pytestmark = [pytest.mark.realdata, pytest.mark.usefixtures("not_simulated", "mistakes_not_sought")]

ARMS = ("ur10", "panda", "tx40")
FILES = {"ur10": ("ur10_unisa1.npz", 1), "panda": ("panda_gaz1.npz", 4), "tx40": ("tx40_t1.npz", 20)}
"""Recording, and the rows of which one is taken."""

TX40 = Path(__file__).parents[2] / "examples" / "tx40.yaml"


@cache
def robot(name: str, folder: Path) -> RobotFile:
    if name == "tx40":
        return parse_robot(TX40.read_text(encoding="utf-8"), where=name, folder=folder)
    sensor = ", inertia: false" if name == "panda" else ""
    joints = load_robot(folder / f"{name}.urdf").robot.joint_names
    rated = (87, 87, 87, 87, 12, 12, 12) if name == "panda" else (330, 330, 150, 56, 56, 56)
    limits = "\n".join(
        f"  - {{name: {joint}, position: [-6.3, 6.3], velocity: 6, torque: {torque}}}"
        for joint, torque in zip(joints, rated, strict=True)
    )
    drives = "\n".join(f"  - {{joint: {joint}, signal: torque{sensor}}}" for joint in joints)
    text = f"name: {name}\nmodel: {{urdf: {name}.urdf, mounting: free}}\njoints:\n{limits}\ndrives:\n{drives}\n"
    return parse_robot(text, where=name, folder=folder)


@cache
def recording(name: str, folder: Path) -> Recording:
    file, every = FILES[name]
    return with_velocity(sampled(import_file(folder / file, robot(name, folder), ImportChoices()), every))


@cache
def found(name: str, folder: Path) -> Identification:
    stop = 7.45 if name == "tx40" else None
    choices = IdentifyChoices(
        model=ModelChoices(friction="coulomb-viscous"),
        preprocess=PreprocessChoices(stop=stop),
        search_delay=False,
        presliding=False,
    )
    return identify([recording(name, folder)], [], choices)


def spoilt(sound: Identification, torque: dict[int, FloatArray], position: FloatArray | None = None) -> Identification:
    """Fitted anew with other torques (n, N) of segments, by number, or with positions shifted by (n,)."""
    kernel = RegressorKernel(sound.model, sound.base.columns)
    (run,) = sound.runs

    def changed(number: int, segment: Segment) -> Segment:
        moved = segment.position if position is None else segment.position + position[:, None]
        return replace(segment, torque=torque.get(number, segment.torque), position=moved)

    prepared = replace(run.prepared, segments=tuple(changed(*one) for one in enumerate(run.prepared.segments)))
    reduction = reduce_torques(kernel, [prepared], sound.experiment.torques)
    solution = weighted_least_squares(reduction, sound.solution.active)
    series = compare_torques(
        kernel.model, kernel.columns, solution.parameters, prepared.segments, prepared.parallel_filter
    )
    return replace(
        sound,
        runs=(replace(run, prepared=prepared),),
        reduction=reduction,
        estimation=replace(sound.estimation, solution=solution, reduction=reduction),
        fit_series=tuple(series),
    )


def named(of: Identification) -> list[tuple[str, tuple[str, ...]]]:
    runs = [run.prepared for run in of.runs]
    independent = of.corrected.effective_rows
    checks = mistake_checks(of.model, of.experiment, of.base, runs, of.solution, independent)
    # A note that the data do not show the lengths finds no mistake.
    return [(check.name, check.joints) for check in checks if check.name != "lengths-unchecked"]


@pytest.mark.parametrize("name", ARMS)
def test_a_contact_is_named_by_its_time_and_nothing_without_one(data_dir: Path, name: str) -> None:
    sound = found(name, data_dir)
    assert "residual-bursts" not in {check.name for check in sound.checks}
    segment = sound.runs[0].prepared.segments[0]
    start = float(segment.time[0] + 0.4 * (segment.time[-1] - segment.time[0]))
    shape = np.sin(np.pi * np.clip((segment.time - start) / 0.5, 0.0, 1.0))
    size = 0.7 * np.sqrt(np.mean(segment.torque**2, axis=1)) * np.array([1, -1] * 4)[: len(segment.torque)]
    (check,) = burst_checks(spoilt(sound, {0: segment.torque + size[:, None] * shape}))
    begin, end = (float(one) for one in check.text.split("residual: ")[1].split(" s")[0].split(", ")[0].split("-"))
    first = start - float(sound.runs[0].signals.time[0])
    assert begin < first + 0.3 < end
    assert end - begin < 2.0


@pytest.mark.parametrize("name", ["ur10", "tx40"])
def test_torques_without_sign(data_dir: Path, name: str) -> None:
    sound = found(name, data_dir)
    segments = sound.runs[0].prepared.segments
    assert named(sound) == []
    ((check, _),) = named(spoilt(sound, {number: np.abs(one.torque) for number, one in enumerate(segments)}))
    assert check == "unsigned-torque"


@pytest.mark.parametrize("name", ["panda", "tx40"])  # the UR10's are named in test_mistakes_real
def test_opposite_torques_come_with_the_refit(data_dir: Path, name: str) -> None:
    sound = found(name, data_dir)
    segments = sound.runs[0].prepared.segments
    turned = spoilt(sound, {number: -one.torque for number, one in enumerate(segments)})
    assert [check for check, _ in named(turned)] == ["torques-opposite"]
    text = with_opposite_torques(turned, raised("torques-opposite", "all")).text
    assert "--repair opposite-torque" in text
    assert f"its mass is {weight(sound)} instead of" in text


def weight(of: Identification) -> str:
    assert of.consistent is not None
    count = len(of.model.joints)
    return f"{of.consistent.parameters.values[: 10 * count].reshape(count, 10)[:, 9].sum():.0f} kg"


@pytest.mark.parametrize(("name", "joint"), [("panda", 1), ("panda", 3)])
def test_a_zero_that_is_off_by_5_degrees(data_dir: Path, name: str, joint: int) -> None:
    """Named where the data tell; the estimate holds the shift."""
    sound = found(name, data_dir)
    shift = np.deg2rad(5.0) * (np.arange(sound.model.dof) == joint)
    moved = spoilt(sound, {}, shift)
    few = instants(RegressorKernel(sound.model, sound.base.columns), [run.prepared for run in moved.runs])
    refit = Refit(moved.model, moved.experiment, moved.base.columns, few, moved.solution)
    estimate = refit.deviation(Unknown("zero", joint))
    assert estimate is not None
    assert np.rad2deg(estimate.value) == pytest.approx(-5.0, abs=2.0)


@each("factor", [1000.0, 10.0, 0.1])
@each("name", ARMS)
def test_torques_of_another_unit(data_dir: Path, name: str, factor: float) -> None:
    """Milliampere, and gains that are missing or applied twice; the TX40's torques show in its URDF's mass."""
    sound = found(name, data_dir)
    assert sound.consistent is not None
    robot_of, parameters = sound.robot_file.robot, sound.consistent.parameters
    torque, position = sound.runs[0].signals.torque, sound.runs[0].signals.position.T
    found_of = [
        check.name
        for scale in (1.0, factor)
        for check in (
            *torque_level_checks(sound.robot_file, sound.model, scale * torque),
            *weight_checks(
                robot_of, sound.model, sound.base, scale * parameters.base, position, scale * parameters.apparent_mass
            ),
        )
    ]
    expected = {1000.0: "torque-beyond-limits", 10.0: "implausible-load", 0.1: "torque-far-below-limits"}
    assert set(found_of) <= {"torque-beyond-limits", "implausible-load", "torque-far-below-limits"}
    assert expected[factor] in found_of or (name == "tx40" and (factor == 0.1 or "torque-beyond-limits" in found_of))
    assert len(found_of) <= 2


@pytest.mark.parametrize("name", ARMS)
def test_stale_samples_and_units_of_the_positions(data_dir: Path, name: str) -> None:
    run = recording(name, data_dir)
    joints = run.streams[JOINTS_STREAM].channels["position"].columns
    assert not unit_checks(run)
    usual = {check.name for check in stale_checks(run)}
    assert usual <= ({"rows-repeated"} if name == "panda" else set())
    middle = 0.3 * float(np.ptp(run.streams[JOINTS_STREAM].time))
    (stuck,) = (check for check in stale_checks(stuck_encoder(run, 1, middle, 1.0)) if check.name == "encoder-stuck")
    assert stuck.joints == (joints[1],)
    assert "rows-repeated" in {check.name for check in stale_checks(repeated_rows(run, 0.13, 1))}
    degrees = np.rad2deg(run.streams[JOINTS_STREAM].channels["position"].values)
    (unit,) = unit_checks(with_values(run, position=degrees))
    assert "in degrees" in unit.text


def test_jitter_lowers_the_cut_offs(data_dir: Path) -> None:
    jittering = jittering_position(recording("ur10", data_dir), 0.004, 1)
    choices = replace(found("ur10", data_dir).choices, preprocess=PreprocessChoices())
    assert "positions-jitter" in {check.name for check in identify([jittering], [], choices).checks}
