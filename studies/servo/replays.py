"""Files for simulators against the servo model that they are made of: roll-outs on recorded commands.

A simulated SO-101 is identified from one recording, and each file rolled out on another: an MJCF by MuJoCo, the others
by the law that their fields mean. Mean absolute errors of positions over all joints [mrad].

`python -m studies.servo.replays` takes about two minutes of CPU time; a model's folder and a recording may be given.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import dynid
from sim_drivers.synthetic.servo import simulate_servo


def main() -> None:
    """Print a row per file."""
    other = simulate_servo("so101", duration=30.0, seed=2) if len(sys.argv) < 3 else dynid.read_recording(sys.argv[2])
    if len(sys.argv) > 1:
        model = dynid.load_servo_model(sys.argv[1])
    else:
        run = simulate_servo("so101", duration=30.0, seed=1)
        model = dynid.identify_servo(run, validation=simulate_servo("so101", duration=6.0, seed=3))
    print("| file | values nearest to the model | values as identified | dynid | not in the file |")
    print("|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for path, write in (
            (folder / "arm.xml", model.export_mjcf),
            (folder / "arm_cfg.py", model.export_isaaclab),
            (folder / "arm.usda", model.export_usd),
        ):
            replayed = write(path, other)
            assert replayed is not None
            errors = (replayed.error, replayed.identified_error, replayed.model_error)
            cells = [replayed.file, *(f"{1e3 * error:.2g}" for error in errors), ", ".join(replayed.left_out)]
            print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
