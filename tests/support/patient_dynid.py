"""`dynid` with time limits that no stall of a busy computer passes, for runs in real time.

The motion process imports this file, too, since its function stands here.
"""

from __future__ import annotations

import sys
from typing import Any

from drivers.rtde import motion

PATIENCE = 60.0

motion.SILENCE_LIMIT = motion.PATIENCE = motion.STOP_LIMIT = PATIENCE
motion.WATCHDOG_RATE = 0.25
_run = motion._run


def run_patiently(*arguments: Any) -> None:
    """What the motion process does, with the limits above."""
    _run(*arguments)


def be_patient() -> None:
    """Everything that the motion process, which starts within the recording, has no use for."""
    from daq.motion import player
    from daq.session import command_gate, play
    from daq.session import supervisor as safety
    from drivers.canopen402 import driver, settings
    from drivers.canopen402.motion import drive_motion, target_path
    from drivers.canopen402.setup import configuration, readiness
    from drivers.rtde import receiver

    safety.STALE_FLOOR = safety.TRACKING_WINDOW = PATIENCE
    safety.Limits.of_robot.__func__.__defaults__ = (10.0,)  # type: ignore[attr-defined]
    command_gate.GateLimits.of_joints.__func__.__defaults__ = (10.0,)  # type: ignore[attr-defined]
    player.DRY_RUN_PERIODS, player.BEHIND = 10_000, 1.0
    player.STALL_LIMIT = player.UNHELD_STALL_LIMIT = drive_motion.STALL_LIMIT = drive_motion.BRIDGED = (
        command_gate.STALL_LIMIT
    ) = command_gate.FRESH = PATIENCE
    target_path.RUN_OUT = 1e6
    play.ARRIVAL_LIMIT = play.REST_LIMIT = PATIENCE
    play.FIRST_SAMPLE_LIMIT = PATIENCE
    receiver.SILENCE_LIMIT = PATIENCE
    settings.CanopenSettings.model_fields["sdo_timeout"].default = 5.0  # a poll of a bus that is gone lasts as long
    settings.CanopenSettings.model_rebuild(force=True)
    configuration.PROBE_LIMIT = readiness.SETTLE_LIMIT = PATIENCE
    driver.SILENCE_LIMIT = driver.FIRST_ROW_LIMIT = PATIENCE


if __name__ == "__main__":
    import patient_dynid

    from dynid.command import main

    motion._run = patient_dynid.run_patiently
    be_patient()
    sys.exit(main())
