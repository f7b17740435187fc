"""`dynid record` on CAN against `dynid sim`, each in its own process: what only processes and sockets can show.

In real time, hence with limits that no stall of this computer reaches; what happens when, and what every row says, is
tested in simulated time (tests/drivers/canopen402/test_recording.py).
"""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
from pathlib import Path

import pytest
from can_record_bench import (
    PATIENCE,
    Probe,
    an_arm,
    assert_recorded,
    assert_stopped,
    changed,
    recorder,
    simulated,
    swing,
    type_fault,
)

from daq.recording.reader import read_recording

pytestmark = [pytest.mark.slow, pytest.mark.realtime]

WIDE: dict[str, object] = {"with": [], "sync_rate": 10, "heartbeat": 1.0, "timeout": 60.0}
"""A drive and dynid miss each other after 3 s."""


def test_a_typed_fault_ends_the_recording_and_is_its_reason(tmp_path: Path) -> None:
    arm, out = an_arm(tmp_path, **WIDE, mode="none"), tmp_path / "run.h5"
    with simulated(arm, "canopen") as (_, process), recorder(arm, "canopen", out, "--duration", "600") as program:
        type_fault(process, "over-temperature 3", program, out)
        reason = "elbow_joint: fault: drive temperature too high (EMCY 0x4310, register: generic, temperature)"
        assert_stopped(program, out, reason)


def test_an_adapter_on_a_pty_is_recorded_until_it_is_pulled_out(tmp_path: Path) -> None:
    arm, out = an_arm(tmp_path, **WIDE, mode="none"), tmp_path / "run.h5"
    with simulated(arm, "slcan") as (ready, process):
        assert ready["interface"] == "slcan"
        changed(arm, "canopen", interface="slcan", channel=ready["channel"], options={})
        with recorder(arm, "canopen", out, "--duration", "600") as program:
            type_fault(process, "unplug", program, out)
            assert_stopped(program, out, "the CAN adapter", "no complete sample")


def test_drives_rest_by_themselves_when_the_program_is_killed_and_the_next_recording_is_complete(
    tmp_path: Path,
) -> None:
    arm, out = an_arm(tmp_path, **{**WIDE, "sync_rate": 100}), tmp_path / "run.h5"
    with simulated(arm, "canopen") as (ready, process), Probe(arm) as probe:
        assert {name: ready[name] for name in ("interface", "channel", "bitrate")} == {
            "interface": "udp_multicast",
            "channel": arm.group,
            "bitrate": 1_000_000,
        }
        assert list(ready["nodes"].values()) == [1, 2, 3, 4, 5, 6]
        with recorder(arm, "canopen", out, "--trajectory", str(swing(tmp_path))) as program:
            probe.wait_for_motion(program)
            program.kill()
            assert program.wait(PATIENCE) == -signal.SIGKILL
        assert probe.wait_for_losses() == [1, 2, 3, 4, 5, 6]
        assert probe.wait_until_off() == [1, 2, 3, 4, 5, 6]
        changed(arm, "canopen", sync_rate=10)  # which no busy computer loses
        again = tmp_path / "again.h5"
        with recorder(arm, "canopen", again, "--duration", "1") as program:
            assert_recorded(program)
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
    recording = read_recording(again)
    assert recording.complete
    rows = len(recording.streams["joints"].time)
    assert rows > 0
    if (lister := shutil.which("h5ls")) is not None:
        listed = subprocess.run([lister, "-r", str(again)], capture_output=True, text=True, check=True).stdout
        assert re.search(rf"/streams/joints/position +Dataset {{{rows}/Inf, 6}}", listed)
