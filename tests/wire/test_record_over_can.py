"""`dynid record` on CAN and serial wires against `dynid sim`: each in its own process, faults typed into the arm."""

from __future__ import annotations

import re
import shutil
import signal
import struct
import subprocess
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import can
import h5py
import numpy as np
import pytest
import yaml
from can_record_bench import (
    SYNC_RATE,
    Arm,
    Probe,
    an_arm,
    assert_stopped,
    changed,
    recorder,
    simulated,
    swing,
    with_fault,
)
from numpy.typing import NDArray

from daq.recording import read_recording

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("fault", "reasons"),
    [
        # A busy computer may find the samples stale before it hears what the drive has to say.
        ("over-temperature 3", ("elbow_joint: fault: drive temperature too high (EMCY 0x4310", "stale data")),
        ("heartbeat-stop 3", ("elbow_joint (node 3): no heartbeat", "stale data")),
        ("power-cycle 3", ("stale data of stream joints", "elbow_joint")),
        ("bus-off 0.5", ("stale data of stream joints", "no heartbeat")),
    ],
)
def test_a_fault_of_a_drive_ends_the_motion(tmp_path: Path, fault: str, reasons: tuple[str, ...]) -> None:
    outcome = with_fault(an_arm(tmp_path), tmp_path, fault)
    assert_stopped(outcome, *reasons)
    if fault.startswith("power-cycle") and "(no answer to SYNC" in outcome.errors:
        assert "(no answer to SYNC of elbow_joint (node 3) for 0." in outcome.errors
    assert outcome.enabled == []
    assert outcome.moved < 2e-3


@pytest.mark.parametrize("keys", [{"heartbeat": 0.1}, {"guarding": {"period": 0.1, "factor": 3}}])
def test_drives_rest_by_themselves_when_the_program_is_killed(tmp_path: Path, keys: dict[str, object]) -> None:
    arm, out = an_arm(tmp_path, **{"with": []}, **keys), tmp_path / "run.h5"
    with simulated(arm, "canopen"), Probe(arm) as probe:
        with recorder(arm, "canopen", out, "--trajectory", str(swing(tmp_path))) as program:
            probe.wait_for_motion(program)
            enabled = probe.enabled()
            program.kill()
            killed = time.time()
            assert program.wait() == -signal.SIGKILL
            assert enabled == [1, 2, 3, 4, 5, 6]
            lost = probe.losses(killed, 3.0)
        # 0.3 s after the last sign of life, which was up to 0.1 s before the end; then the quick stop.
        assert sorted(lost) == [1, 2, 3, 4, 5, 6]
        assert all(0.19 < after < 0.8 for after in lost.values()), lost
        end = time.monotonic() + 1.0
        while (enabled := probe.enabled()) and time.monotonic() < end:
            time.sleep(0.02)
        print(f"killed: {lost}, off after {time.time() - killed:.3f} s")
        assert enabled == []
        assert probe.moved_in(0.4) < 1e-3  # the brakes have fallen in
        with recorder(arm, "canopen", tmp_path / "again.h5", "--duration", "1") as program:
            assert program.communicate(timeout=30)[1] == ""
        assert program.returncode == 0


def test_a_program_that_was_suspended_ends_and_says_why(tmp_path: Path) -> None:
    arm, out = an_arm(tmp_path, **{"with": []}), tmp_path / "run.h5"
    with simulated(arm, "canopen"), Probe(arm) as probe:
        with recorder(arm, "canopen", out, "--trajectory", str(swing(tmp_path))) as program:
            probe.wait_for_motion(program)
            program.send_signal(signal.SIGSTOP)
            lost = probe.losses(time.time(), 3.0)
            time.sleep(0.2)
            enabled = probe.enabled()
            program.send_signal(signal.SIGCONT)
            errors = program.communicate(timeout=30)[1]
        assert sorted(lost) == [1, 2, 3, 4, 5, 6]
        assert enabled == []
        assert probe.enabled() == []
    assert program.returncode == 1
    assert "it no longer heard dynid" in errors or "stale data" in errors, errors
    recording = read_recording(out)
    assert not recording.complete
    assert sum("it no longer heard dynid" in event.message for event in recording.events) >= 6


def test_swapped_node_ids_are_found_before_anything_moves(tmp_path: Path) -> None:
    arm = an_arm(tmp_path)
    nodes = yaml.safe_load(arm.path.read_text(encoding="utf-8"))["connections"]["canopen"]["nodes"]
    changed(arm, "canopen", nodes={joint: {**node, "serial": node["id"]} for joint, node in nodes.items()})
    out = tmp_path / "run.h5"
    with simulated(arm, "canopen", "--swap", "1,2", "--thermometer"), Probe(arm) as probe:
        with recorder(arm, "canopen", out, "--trajectory", str(swing(tmp_path))) as program:
            errors = program.communicate(timeout=30)[1]
        assert program.returncode == 1
        assert "shoulder_pan_joint (node 1)" in errors
        assert "serial number" in errors
        assert not out.exists()
        assert probe.enabled() == []


def test_an_adapter_that_is_pulled_out(tmp_path: Path) -> None:
    outcome = with_fault(an_arm(tmp_path), tmp_path, "unplug", wire="slcan", duration=10.0)
    assert_stopped(outcome, "the CAN adapter", "no complete sample")


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("thermometer silent 2", ("thermometer: no temperature for", "thermometer: speaks again")),
        ("thermometer unplug 1", ("thermometer: the port has gone", "thermometer: the port is open again")),
        ("thermometer garbage 1", ("line(s) ignored",)),
    ],
)
def test_a_thermometer_in_trouble_ends_nothing(tmp_path: Path, fault: str, words: tuple[str, ...]) -> None:
    outcome = with_fault(an_arm(tmp_path), tmp_path, fault, duration=5.0, thermometer=True)
    assert (outcome.status, outcome.errors) == (0, "")
    assert outcome.recording is not None
    assert outcome.recording.complete
    assert len(outcome.recording.streams["thermometer"].time) > 5
    for word in words:
        assert sum(word in event for event in outcome.events()) >= 1


def test_truncated_frames_are_told_and_cost_their_rows(tmp_path: Path) -> None:
    outcome = with_fault(an_arm(tmp_path), tmp_path, "truncate 24", duration=3.0)
    assert (outcome.status, outcome.errors) == (0, "")
    assert any("frames of a wrong length" in event for event in outcome.events())


def test_a_dbc_that_overlaps_signals_is_refused_before_the_bus_is_touched(tmp_path: Path) -> None:
    arm = an_arm(tmp_path)
    (tmp_path / "arm.dbc").write_text(
        'VERSION ""\n\nBU_: Arm\n\nBO_ 385 Positions: 8 Arm\n'
        ' SG_ position_shoulder_pan_joint : 0|24@1- (1e-6,0) [0|0] "rev" Arm\n'
        ' SG_ position_shoulder_lift_joint : 16|24@1- (1e-6,0) [0|0] "rev" Arm\n'
    )
    content = yaml.safe_load(arm.path.read_text(encoding="utf-8"))
    can_keys = content["connections"]["can"]
    content["connections"]["can"] = {
        key: can_keys[key] for key in ("driver", "interface", "channel", "bitrate", "options", "rate")
    } | {"dbc": "arm.dbc"}
    arm.path.write_text(yaml.safe_dump(content, sort_keys=False))
    with recorder(arm, "can", tmp_path / "run.h5", "--duration", "1") as program:
        errors = program.communicate(timeout=30)[1]
    assert program.returncode == 2
    assert errors.count("\n") == 1
    assert "arm.dbc" in errors
    assert "overlap" in errors
    assert not (tmp_path / "run.h5").exists()


def nodes(arm: Arm) -> dict[str, Any]:
    """The drives of the robot file, by joint, in the joints' order."""
    content = yaml.safe_load(arm.path.read_text(encoding="utf-8"))
    by_name = content["connections"]["canopen"]["nodes"]
    return {joint["name"]: by_name[joint["name"]] for joint in content["joints"]}


def answered_cycles(frames: Iterable[can.Message]) -> NDArray[np.float64]:
    """Currents [‰ of the rated one] (cycles, 6) of the SYNCs that every drive answered with both its TPDOs."""
    answers = {base + node for base in (0x180, 0x280) for node in range(1, 7)}
    cycles: list[dict[int, bytes]] = [{}]
    for frame in frames:
        if frame.arbitration_id == 0x80:
            cycles.append({})
        elif frame.arbitration_id in answers:
            cycles[-1][frame.arbitration_id] = bytes(frame.data)
    complete = [cycle for cycle in cycles if cycle.keys() == answers]
    currents = [[struct.unpack_from("<h", cycle[0x280 + node], 6)[0] for node in range(1, 7)] for cycle in complete]
    return np.array(currents, dtype=np.float64)


def test_the_recording_and_python_cans_own_logger_agree(tmp_path: Path) -> None:
    arm, out, log = an_arm(tmp_path), tmp_path / "run.h5", tmp_path / "bus.blf"
    changed(arm, "canopen", mode="none", **{"with": []})
    bus = can.Bus(interface="udp_multicast", channel=arm.group, port=arm.port, hop_limit=0, ignore_config=True)
    with simulated(arm, "canopen"):
        notifier = can.Notifier(bus, [can.Logger(log)])
        with recorder(arm, "canopen", out, "--duration", "3") as program:
            errors = program.communicate(timeout=30)[1]
        notifier.stop()
        bus.shutdown()
    assert (program.returncode, errors) == (0, "")
    with h5py.File(out) as file:
        joints = file["streams/joints"]
        ours = np.rint(joints["current"][:] / [1e-3 * node["rated_current"] for node in nodes(arm).values()])
    rows = len(ours)
    theirs = answered_cycles(can.LogReader(log))
    # Row by row, value by value, in order. A busy computer may give the log a SYNC before the last answers to the one
    # before, which then look incomplete there; nothing may be in the log twice, or in another order.
    place, agreeing = -1, []
    for row in ours:
        following = (k for k in range(place + 1, len(theirs)) if np.array_equal(theirs[k], row))
        if (found := next(following, None)) is not None:
            place = found
            agreeing.append(found)
    assert len(agreeing) >= 0.95 * rows
    assert agreeing[-1] - agreeing[0] + 1 <= rows
    assert rows >= 2.5 * SYNC_RATE
    assert agreeing[-1] >= len(theirs) - 3
    lister = shutil.which("h5ls")
    if lister is not None:
        listed = subprocess.run([lister, "-r", str(out)], capture_output=True, text=True, check=True).stdout
        assert re.search(rf"/streams/joints/position +Dataset {{{rows}/Inf, 6}}", listed)
