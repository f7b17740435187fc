"""What `dynid check` and `dynid info` print for people."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from daq.commands.console import print_table
from drivers.bus_budget import TIGHT_SHARE, Budget
from drivers.core.text import percent_text
from ident.checks.connection_check import CheckedConnection
from ident.checks.recording_check import RecordingInfo
from ident.checks.recording_tables import column_table, motion_table, stream_table
from ident.checks.tool_pose import ToolPose
from ident.commands.printing.result import print_tables
from ident.commands.printing.verdict import next_steps, print_next
from ident.excite.sufficiency import Sufficiency, TimesNeeded
from ident.regression.options import SIGNIFICANT_RSD

MOST_CHECKS = 4
"""Checks of a recording that are printed without `--verbose`, the most serious first."""


def print_budget(name: str, budget: Budget, *, verbose: bool = False) -> None:
    """Print the load of a bus; with `verbose` what a cycle consists of."""
    worst = f" {budget.worst}" if budget.worst else ""
    print(
        f"  connection {name}: bus load {percent_text(budget.load)} ({budget.bitrate / 1e3:g} kbit/s) at "
        f"{budget.rate:g} Hz{worst}; at most {budget.highest_rate():.0f} Hz, "
        f"{budget.highest_rate(TIGHT_SHARE):.0f} Hz for {percent_text(TIGHT_SHARE)}"
    )
    if not verbose:
        return
    cycle = Counter[tuple[str, int]]()
    for group in budget.cycle:
        cycle[group.meaning, group.data_bytes] += group.count
    listed = ", ".join(f"{count} × {meaning} ({size} bytes)" for (meaning, size), count in cycle.items())
    print(f"    a cycle of {budget.cycle_bits} bits: {listed}")
    for group, rate in budget.beside:
        print(f"    beside it: {group.count} × {group.meaning} ({group.data_bytes} bytes) at {rate:g} Hz")


def print_poses(poses: tuple[ToolPose, ...]) -> None:
    """The poses as a table, lengths in mm as pendants show them."""
    rows = []
    for pose in poses:
        rows.append(
            (
                pose.name + (f" (beyond the limits of {', '.join(pose.beyond)})" if pose.beyond else ""),
                *(f"{1000 * value:.2f}" for value in pose.position),
                *(f"{value:.4f}" for value in pose.rotation_vector),
                *(f"{np.degrees(value):.2f}" for value in pose.rpy),
            )
        )
    heads = ("pose", "x mm", "y mm", "z mm", "RX rad", "RY rad", "RZ rad", "roll °", "pitch °", "yaw °")
    print_table("Tool in the base frame (compare with the pendant)", heads, rows)


def print_connection(connection: CheckedConnection, *, verbose: bool = False) -> None:
    """Print the outcome of the check; with `verbose` its own limits and the first sample of every stream."""
    print(f"\nconnection {connection.name} ({connection.driver}) answers")
    for identity in connection.identities:
        shown = {key.replace("_", " "): value for key, value in identity.items() if value not in (None, "")}
        print(
            "  "
            + ", ".join(
                f"{key} {value:.10g}" if isinstance(value, float) else f"{key} {value}" for key, value in shown.items()
            )
        )
    if connection.limits and verbose:
        joints = dict.fromkeys(joint for of_joints in connection.limits.values() for joint in of_joints)
        limits = [(joint, *(limit.get(joint) for limit in connection.limits.values())) for joint in joints]
        print_table("  limits of its own", ("", *connection.limits), limits)
    for stream in connection.streams:
        rate = "" if stream.rate_hz is None else f" at {stream.rate_hz:.4g} Hz"
        stated = f" (nominal: {stream.nominal_hz:.4g} Hz)" if stream.nominal_hz > 0 else ""
        print(f"  stream {stream.name}{rate}{stated}: {', '.join(stream.first)}")
        if not verbose:
            continue
        alike: dict[tuple[str, ...], list[str]] = {}
        for quantity, values in stream.first.items():
            alike.setdefault(tuple(values), []).append(quantity)
        for columns, quantities in alike.items():
            headers = [f"{quantity} [{stream.units[quantity]}]" for quantity in quantities]
            rows = [(column, *(stream.first[quantity][column] for quantity in quantities)) for column in columns]
            print_table("", ("", *headers), rows)
    for notice in connection.notices:
        print(f"  {notice}")
    for warning in connection.warnings:
        print(f"  warning: {warning}")
    if not connection.warnings:
        print("  consistent with the robot file")


def print_info(info: RecordingInfo, file: str, *, verbose: bool = False) -> None:
    """Print the quality of a recording: verdict, streams, motion and what to do; with `verbose` all the rest."""
    recording, verdict = info.recording, info.verdict
    state = "complete" if recording.complete else "stopped early" if recording.stopped_by else "NOT closed properly"
    print(f"{file}: {info.robot.name}, {state}, created {recording.created or 'at an unknown time'}")
    print(f"Judging by the recording alone: {verdict.grades}")
    print_tables([replace(stream_table(info, file), title=""), replace(motion_table(info), title="")])
    if info.excitation is not None:
        print(f"column-normalised condition number: {info.excitation.scaled_condition:.4g}")
    if info.delay is not None and info.delay.best is not None and np.isfinite(info.delay.best):
        print(f"delay: {info.delay.note}")
    if info.sufficiency is not None:
        _print_sufficiency(info.sufficiency, info.times)
    for check in verdict.checks[: len(verdict.checks) if verbose else MOST_CHECKS]:
        print(f"{check.severity}: {check.text} [{check.name}]")
    if not verdict.checks:
        print("Checks on this recording: no problems found.")
    steps = next_steps(verdict, f"dynid identify {file} -o model")
    if any(check.name == "no-torque" for check in verdict.checks):
        steps.append(f"dynid identify {file} --method servo -o model")
    print_next(steps, verdict, "All figures: --verbose, or --page FOLDER.")
    if verbose:
        print_tables([column_table(info)])
        for event in recording.events:
            print(f"{event.level} at {event.time:.3f} s, {event.source}: {event.message}")


def _print_sufficiency(sufficiency: Sufficiency, times: TimesNeeded | None) -> None:
    expected = sufficiency.forecast
    rsds = [p.rsd_percent for p in expected.parameters if p.rsd_percent is not None]
    if rsds:
        significant = sum(value < SIGNIFICANT_RSD for value in rsds)
        print(
            f"predicted RSD below {SIGNIFICANT_RSD:g} % for {significant} of {len(rsds)} base parameters, from "
            f"{sufficiency.seconds:.1f} s of motion (parameters and noise: {sufficiency.source})"
        )
    if times is None:
        return
    if times.parameters:
        print_table(
            f"\nTime needed for an RSD of {times.wanted_rsd_percent:g} %",
            ("parameter", "RSD now [%]", "needed [s]"),
            [(entry.name, entry.rsd_percent, entry.seconds) for entry in times.parameters],
        )
    print(times.sentence)
