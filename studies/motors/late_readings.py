"""What late readings of CAN motors do to a model, with and without what dynid does about them; in simulated time.

    python -m studies.motors.late_readings [MOTION_SECONDS]

The arm of the tests (two joints, 60 N·m/rad, viscous friction 0.1 N·m·s/rad) at 100 Hz. Every reading begins up to so
many milliseconds late, evenly distributed. `without`: without `goal_age`.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "support"))

from motor_bench import motors
from simulated_clock import simulated_time

from daq.motion.trajectories import FourierSeries, RestToRest
from daq.recording.reader import read_recording
from daq.recording.recording import Recording
from drivers.can_motors.bus import MotorBus
from drivers.streams import GOAL_AGE
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify

LATE = (0.0, 0.002, 0.005)
"""[s] at most."""


def recorded(wire: str, late: float, seconds: float) -> Recording:
    """A motion of so many seconds, read up to so many late."""
    rng = np.random.default_rng(1)
    draw = 0.3 * rng.uniform(-1.0, 1.0, (2, 2, 3)) / [1.0, 1.5, 2.0]
    series = FourierSeries.from_position_amplitudes(seconds, np.array([-1.3, 0.2]), *draw)
    cycle = MotorBus.cycle

    def slow(bus: MotorBus, commands: object = None, *arguments: object, **keywords: object) -> object:
        bus._clock.sleep(rng.uniform(0.0, late))
        return cycle(bus, commands, *arguments, **keywords)  # type: ignore[arg-type]

    with TemporaryDirectory() as folder, simulated_time() as clock:
        path = Path(folder) / "run.h5"
        try:
            MotorBus.cycle = slow  # type: ignore[method-assign,assignment]
            with motors(clock, wire, when_lost="hold" if wire == "odrive" else "limp") as bench:
                report = bench.play(path, RestToRest(series, 1, 0.5))
        finally:
            MotorBus.cycle = cycle  # type: ignore[method-assign]
        assert report.stopped_by is None, report.stopped_by
        return read_recording(path)


def without_ages(run: Recording) -> Recording:
    """The recording without when goals were obeyed."""
    joints = run.streams["joints"]
    channels = {name: channel for name, channel in joints.channels.items() if name != GOAL_AGE}
    return replace(run, streams={**run.streams, "joints": replace(joints, channels=channels)})


def main() -> None:
    """Print the table."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 3.0
    print("| motors | late at most [ms] | | viscous friction less the true one [N·m·s/rad] | residual [%] |")
    print("|---|---|---|---|---|")
    for wire in ("damiao", "odrive"):
        for late in LATE:
            mended = recorded(wire, late, seconds)
            for words, run in (("without", without_ages(mended)), ("with", mended)):
                found = identify([run], [], IdentifyChoices())
                named = dict(zip(found.base.names, found.solution.parameters, strict=True))
                off = " and ".join(f"{named[name] - 0.1:+.3f}" for name in ("Fv1", "Fv2"))
                error = 100.0 * found.fit.relative_error
                print(f"| {wire} | {1e3 * late:g} | {words} | {off} | {error:.1f} |", flush=True)


if __name__ == "__main__":
    main()
