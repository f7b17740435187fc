"""What a free and a loaded run say, in words and as the object that `--json` prints."""

from __future__ import annotations

from typing import Any

import numpy as np

from ident.experiments.drive_gains import DriveGains
from ident.experiments.load_estimate import LoadEstimate
from ident.experiments.payload import Payload
from ident.experiments.up_and_down import SlowGains
from ident.model.dynamics import DynamicModel
from ident.model.load import FIRST_MOMENTS, KnownLoad, LoadColumns
from ident.model.parameters import INERTIAL
from ident.regression.hypothesis_tests import LEVEL, ChanceTest
from ident.result.schema import UNITS

FRAME_TEXT = "tool frame: origin at workspace.tool, axes of the last joint's frame"


def payload_sentences(found: Payload) -> list[str]:
    """The tests in words."""
    sentences = []
    mass, known = found.load.standard[INERTIAL.index("M")], _known(found)
    if found.mass_test is not None and known is not None:
        place = found.load.columns.kept.index(INERTIAL.index("M"))
        noise = float(np.sqrt(found.load.covariance[place, place]))
        gains = float(np.sqrt(found.load.gain_covariance[place, place]))
        verdict = "agrees with" if found.mass_test.passed else "does not agree with"
        text = (
            f"mass: identified without it, {mass:.4g} ± {noise:.2g} kg {verdict} the known {known.mass:g} kg "
            f"({_p_value(found.mass_test)})"
        )
        if not found.mass_test.passed and abs(mass - known.mass) < 2 * np.hypot(noise, gains):
            text += (
                f"; the robot file's standard deviations of the drive gains make ± {gains:.2g} kg of it, which covers "
                "the difference"
            )
        sentences.append(text)
    if found.values_test is not None:
        sentences.append(
            _sentence(
                found.values_test,
                "the identified load parameters agree with all the known ones",
                "the identified load parameters do not agree with all the known ones",
                "",
            )
        )
    sentences.append(
        _sentence(
            found.load_test,
            "what changed between the runs is what a load on the last link changes",
            "what changed between the runs is not what a load on the last link changes",
            "whether a load explains what changed",
        )
    )
    if known is not None and len(known.known) == len(INERTIAL):
        sentences.append(
            _sentence(
                found.known_test,
                "the free run's base parameters plus the known load agree with those identified loaded",
                "the free run's base parameters plus the known load do not agree with those identified loaded",
                "whether the known load explains what changed",
            )
        )
    if found.rest is not None:
        rest, unit = found.rest, base_unit(found.pair.model, found.pair.base.columns[found.rest.number])
        stayed = "stayed" if rest.test.passed else "did not stay"
        sentences.append(
            f"what a load does not change (friction, motor inertia, …) {stayed} the same: the largest difference is "
            f"{found.pair.base.names[rest.number]}'s, from {rest.free:.4g} to "
            f"{rest.loaded:.4g} {unit}, {rest.test.statistic**0.5:.1f} standard deviations ({_chance(rest.test)})"
        )
    return sentences


def _sentence(test: ChanceTest | None, yes: str, no: str, question: str) -> str:
    if test is None:
        return f"{question}: too few blocks of data to say; record longer, or other motions beside"
    return f"{yes if test.passed else no} ({_p_value(test)})"


def _p_value(test: ChanceTest) -> str:
    return f"χ² = {test.statistic:.1f} with {test.freedom} degrees of freedom; {_chance(test)}"


def _chance(test: ChanceTest) -> str:
    rare = test.p_value < 1e-4
    chance = "less than one run in 10 000" if rare else f"{100 * test.p_value:.2g} % of all runs"
    limit = "" if test.passed else f", the limit is {100 * LEVEL:g} %"
    return f"chance gives more in {chance}{limit}"


def load_rows(estimate: LoadEstimate) -> list[dict[str, Any]]:
    """One entry an identified combination."""
    noise, gains = np.sqrt(np.diag(estimate.covariance)), np.sqrt(np.diag(estimate.gain_covariance))
    return [
        {
            "name": name,
            "expression": estimate.columns.expressions[i],
            "unit": estimate.columns.units[i],
            "value": float(estimate.values[i]),
            "std": float(estimate.std[i]),
            "noise_std": float(noise[i]),
            "gain_std": float(gains[i]),
        }
        for i, name in enumerate(estimate.columns.names)
    ]


def base_unit(model: DynamicModel, column: int) -> str:
    """Unit of a base parameter, by the standard column that it is named after."""
    return UNITS[model.parameters[column].symbol]


def base_rows(found: Payload) -> list[dict[str, Any]]:
    """Base parameters that the load changes, as SR400 Table 4 has them."""
    pair, changes = found.pair, found.changes
    return [
        {
            "name": pair.base.names[number],
            "unit": base_unit(pair.model, pair.base.columns[number]),
            "free": float(changes.free[i]),
            "free_std": float(changes.free_std[i]),
            "predicted": float(changes.predicted[i]),
            "loaded": float(changes.loaded[i]),
            "loaded_std": float(changes.loaded_std[i]),
        }
        for i, number in enumerate(changes.numbers)
    ]


def payload_object(found: Payload) -> dict[str, Any]:
    """What `dynid payload --json` prints."""
    centre = (found.with_mass or found.load).centre
    return {
        "kind": "payload",
        "robot": found.pair.robot_file.robot.name,
        "runs": [run.label for run in found.pair.runs],
        "frame": FRAME_TEXT,
        "load": load_rows(found.load),
        "load_with_known": None if found.with_mass is None else load_rows(found.with_mass),
        "centre_of_mass": None if centre is None else {"value": centre[0].tolist(), "std": centre[1].tolist()},
        "not_identifiable": _regrouped(found.load.columns),
        "unexcited": list(found.load.unexcited),
        "known": _known_object(_known(found)),
        "base_parameters": base_rows(found),
        "tests": {
            "mass": _test_object(found.mass_test),
            "values": _test_object(found.values_test),
            "load": _test_object(found.load_test),
            "known_load": _test_object(found.known_test),
            "unchanged": None
            if found.rest is None
            else {**(_test_object(found.rest.test) or {}), "worst": found.pair.base.names[found.rest.number]},
        },
        "sentences": payload_sentences(found),
        "delay": {"used": found.pair.delay, "note": found.pair.delay_note},
        "blocks": found.blocks,
        "block_length": found.block_length,
        "warnings": list(found.warnings),
    }


def gains_object(found: DriveGains) -> dict[str, Any]:
    """What `dynid gains --json` prints."""
    pair = found.pair
    return {
        "kind": "gains",
        "robot": pair.robot_file.robot.name,
        "runs": [run.label for run in pair.runs],
        "signal": found.signal,
        "unit": gain_unit(found.signal),
        "known": _known_object(found.known),
        "gains": [
            {
                "joint": gain.joint,
                "gain": gain.gain,
                "std": gain.std,
                "rsd_percent": gain.relative_std,
                "file_gain": gain.file_gain,
                "angle_degrees": gain.angle,
                "confused_with": gain.confused_with[0],
                "correlation": gain.confused_with[1],
                "noise": float(noise),
            }
            for gain, noise in zip(found.gains, found.noise, strict=True)
        ],
        "covariance": found.covariance.tolist(),
        "base_parameters": [
            {
                "name": name,
                "unit": base_unit(pair.model, pair.base.columns[i]),
                "value": float(found.parameters[i]),
                "std": float(found.parameter_std[i]),
            }
            for i, name in enumerate(pair.base.names)
        ],
        "load": [
            {"name": name, "unit": unit, "value": float(value), "std": float(std)}
            for name, unit, value, std in zip(
                found.columns.names, found.columns.units, found.load, found.load_std, strict=True
            )
        ],
        "condition": found.condition,
        "gap": found.gap,
        "delay": {"used": pair.delay, "note": pair.delay_note},
        "blocks": found.blocks,
        "block_length": found.block_length,
        "robot_file_text": drives_text(found),
        "warnings": list(found.warnings),
    }


def slow_gains_object(found: SlowGains) -> dict[str, Any]:
    """What `dynid gains --up-and-down --json` prints."""
    return {
        "kind": "gains-up-and-down",
        "robot": found.robot.name,
        "runs": list(found.runs),
        "signal": found.signal,
        "unit": gain_unit(found.signal),
        "known": _known_object(found.known),
        "gains": [
            {
                "joint": gain.joint,
                "gain": gain.gain,
                "std": gain.std,
                "rsd_percent": gain.relative_std,
                "file_gain": gain.file_gain,
                "sweeps": gain.sweeps,
                "positions": gain.bins,
                "speed": gain.speed,
                "friction_free": gain.free_friction,
                "friction_loaded": gain.loaded_friction,
                "reason": gain.reason or None,
            }
            for gain in found.gains
        ],
        "load": [
            {"name": f"{INERTIAL[column]}_L", "unit": "kg·m", "value": float(value), "std": float(std)}
            for column, value, std in zip(FIRST_MOMENTS, found.moments, found.moments_std, strict=True)
        ],
        "gap": found.gap,
        "robot_file_text": drives_text(found),
        "warnings": list(found.warnings),
    }


def gain_unit(signal: str) -> str:
    """Unit of a gain, for revolute joints."""
    return "N·m/A" if signal == "current" else "N·m/V"


def drives_text(found: DriveGains | SlowGains) -> str:
    """The robot file's section `drives` with the identified gains; where there is none, as the file has it."""
    robot = found.robot
    lines = ["drives:"]
    for gain in found.gains:
        drive = robot.drive(gain.joint)
        told = bool(np.isfinite(gain.gain))
        fields = {"joint": gain.joint}
        for key, value in (
            ("gain", f"{gain.gain:.5g}" if told else drive.gain),
            ("gain_std", f"{gain.std:.2g}" if told else drive.gain_std),
        ):
            if value is not None:
                fields[key] = str(value)
        fields |= {"signal": found.signal, "inertia": str(drive.inertia).lower()}
        lines.append(f"  - {{{', '.join(f'{key}: {value}' for key, value in fields.items())}}}")
    return "\n".join(lines)


def _known(found: Payload) -> KnownLoad | None:
    return None if found.with_mass is None else found.with_mass.known


def _known_object(known: KnownLoad | None) -> dict[str, Any] | None:
    if known is None:
        return None
    return {
        "mass": known.mass,
        "com": None if known.com is None else list(known.com),
        "inertia": None if known.inertia is None else list(known.inertia),
    }


def _test_object(test: ChanceTest | None) -> dict[str, Any] | None:
    if test is None:
        return None
    return {
        "statistic": test.statistic,
        "degrees_of_freedom": test.freedom,
        "p_value": test.p_value,
        "passed": test.passed,
    }


def _regrouped(columns: LoadColumns) -> list[str]:
    """Parameters that no column of their own shows: without effect, or only seen together with others."""
    alone = {columns.kept[i] for i in range(len(columns.kept)) if np.count_nonzero(columns.projection[i]) == 1}
    return [f"{symbol}_L" for number, symbol in enumerate(INERTIAL) if number not in alone]
