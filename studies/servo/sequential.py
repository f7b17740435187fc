"""Motion time to given intervals: sequential design of a servo arm's motions against one long design.

A simulated SO-101 plays a first motion of `dynid excite --for servo`, is identified, and plays what `--after` designs,
until the intervals are as narrow as wanted; and it plays ladders of all kinds, each longer than the last, until one
brings the same. Half-widths of 95 % intervals are those of the identification, not the predicted ones, of stiffness,
damping, armature and Coulomb friction of the first four joints. Wrist roll and jaw, whose torque scale neither weight
nor inertia shows, reach ±10 % by neither.

`python -m studies.servo.sequential SEED…` takes about 50 s of CPU time per seed.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import dynid
from daq.recording.recording import Recording
from sim_drivers.synthetic.servo import simulate_servo

CORE = ("stiffness", "damping", "armature", "coulomb")
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex")
WANTED = 10.0
"""[%]"""

FIRST, NEXT, LONGEST = 25.0, 15.0, 160.0
"""[s] of the first motion, of each further one and by which ladders grow, and of all at most."""


def widest(model: dynid.ServoModel) -> float:
    """Half-width [%] of the widest interval; infinite where a parameter is not determined."""
    widths = []
    for joint in model.result.servo:
        for name in CORE if joint.joint in JOINTS else ():
            one = joint.parameters[name]
            known = one.interval is not None and not one.unidentifiable
            widths.append(50.0 * np.log(one.interval[1] / one.interval[0]) if known and one.interval else np.inf)
    return max(widths)


def needed(folder: Path, seed: int, *, sequential: bool) -> tuple[float, list[str]]:
    """Motion time [s] until all intervals are as narrow as wanted, and the widest of each attempt."""
    runs: list[Recording] = []
    seconds, shown, model = 0.0, list[str](), folder / "model"
    for number in range(round((LONGEST - FIRST) / NEXT) + 1):
        after = {"after": model, "wanted": WANTED} if number and sequential else {}
        length = NEXT if after else FIRST if sequential else FIRST + number * NEXT
        motion, _ = dynid.design_servo_motion("so101", length=length, seed=seed + number * sequential, **after)  # type: ignore[arg-type]
        if motion is None:
            break
        motion.save(folder / "motion.yaml", overwrite=True)
        run = simulate_servo("so101", motion=folder / "motion.yaml", seed=seed + number)
        runs = [*runs, run] if sequential else [run]
        seconds = seconds * sequential + motion.duration
        found = dynid.identify_servo(runs, validation=simulate_servo("so101", duration=6.0, seed=77))
        found.save(model, overwrite=True)
        shown.append(f"{widest(found):.0f}")
        if widest(found) <= WANTED:
            return seconds, shown
    return np.inf, shown


def main() -> None:
    """Print a row per seed."""
    print("| seed | sequential [s] | widest after each part [%] | one motion [s] | widest of each [%] | ratio |")
    print("|---|---|---|---|---|---|")
    times = []
    for seed in map(int, sys.argv[1:] or ["30", "40", "50", "60"]):
        with tempfile.TemporaryDirectory() as place:
            both = [needed(Path(place), seed, sequential=sequential) for sequential in (True, False)]
        times.append([time for time, _ in both])
        cells = [f"{time:.0f} | {', '.join(widths)}" for time, widths in both]
        print(f"| {seed} | {' | '.join(cells)} | {times[-1][0] / times[-1][1]:.2f} |", flush=True)
    total = np.sum(times, axis=0)
    print(f"| all | {total[0]:.0f} | | {total[1]:.0f} | | {total[0] / total[1]:.2f} |")


if __name__ == "__main__":
    main()
