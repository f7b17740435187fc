"""Motion time to given intervals: sequential design of a servo arm's motions against one long design.

A simulated SO-101 plays a first motion of `dynid excite --for servo`, is identified, and plays what `--after` designs
for the intervals that are still wide, until all are within the wanted; and it plays ladders of several lengths at once.
Half-widths of 95 % intervals are those of the identification, not the predicted ones, of stiffness, damping, armature
and Coulomb friction of all joints, of those that the data determine.

`python -m studies.servo.sequential` takes about ten minutes of CPU time.
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
WANTED = 10.0
"""[%]"""

FIRST, NEXT, MOST = 25.0, 20.0, 3
"""[s] of the first motion, of each further one, and the number of those."""

LADDERS = (45.0, 75.0)
"""[s]"""


def played(folder: Path, name: str, **options: object) -> tuple[Recording, float] | None:
    """A recording of the simulated arm on a designed motion, and its length [s]; None where none is needed."""
    motion, _ = dynid.design_servo_motion("so101", **options)  # type: ignore[arg-type]
    if motion is None:
        return None
    path = folder / f"{name}.yaml"
    motion.save(path, overwrite=True)
    return simulate_servo("so101", motion=path, seed=len(name)), motion.duration


def half_widths(model: dynid.ServoModel) -> np.ndarray:
    """[%] of the core parameters that were determined."""
    rows = [
        50.0 * np.log(one.interval[1] / one.interval[0])
        for joint in model.result.servo
        for name, one in joint.parameters.items()
        if name in CORE and one.interval is not None and not one.unidentifiable
    ]
    return np.array(rows)


def row(label: str, seconds: float, model: dynid.ServoModel) -> None:
    """Print a row of the table."""
    widths = half_widths(model)
    inside = np.count_nonzero(widths <= WANTED)
    cells = [
        label,
        f"{seconds:.0f}",
        f"{np.median(widths):.1f}",
        f"{np.quantile(widths, 0.9):.1f}",
        f"{widths.max():.1f}",
    ]
    print("| " + " | ".join([*cells, f"{inside} of {len(widths)}"]) + " |", flush=True)


def main() -> None:
    """Print the table."""
    ladders = tuple(float(text) for text in sys.argv[1:]) or LADDERS
    held_out = simulate_servo("so101", duration=6.0, seed=77)
    print("| motion | time [s] | median half-width [%] | 90 % below [%] | widest [%] | within 10 % |")
    print("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        runs, seconds = [], 0.0
        for number in range(MOST + 1):
            options = {"length": FIRST} if not runs else {"length": NEXT, "after": folder / "model", "wanted": WANTED}
            new = played(folder, f"part{number}", seed=number, **options)
            if new is None:
                break
            runs.append(new[0])
            seconds += new[1]
            model = dynid.identify_servo(runs, validation=held_out)
            model.save(folder / "model", overwrite=True)
            row(f"sequential, {len(runs)} part(s)", seconds, model)
            if half_widths(model).max() <= WANTED:
                break
        for length in ladders:
            new = played(folder, f"ladder{length:g}", length=length)
            assert new is not None
            row("one ladder", new[1], dynid.identify_servo(new[0], validation=held_out))


if __name__ == "__main__":
    main()
