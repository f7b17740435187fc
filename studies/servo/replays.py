"""Files for simulators against the servo model that they are made of: roll-outs on recorded commands.

A simulated SO-101 is identified from one recording, and each file rolled out on another: an MJCF by MuJoCo, the others
by the law that their fields mean. Mean absolute errors of positions over all joints [mrad]. With `so101`, each
recording of the real arm in DYNID_DATA is rolled out so, by the model of all but one; Isaac Lab's configuration and USD
have no surface to touch.

`python -m studies.servo.replays [so101]` takes about 12 s of CPU time; two minutes on the real arm.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import dynid
from daq.recording.recording import Recording
from ident.servo.simulators.actuator_law import ServoReplay
from sim_drivers.synthetic.servo import simulate_servo
from studies.servo.so101 import recordings

LEFT_OUT = "slow_precision"
"""Recording of the real arm that is not fitted."""


def replays(model: dynid.ServoModel, run: Recording) -> list[ServoReplay]:
    """Replays of an MJCF, Isaac Lab's configuration and USD."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        found = [
            model.export_mjcf(folder / "arm.xml", run),
            model.export_isaaclab(folder / "arm_cfg.py", run),
            model.export_usd(folder / "arm.usda", run),
        ]
    return [each for each in found if each is not None]


def of_real_arm(named: dict[str, Recording]) -> None:
    """Print a row per recording."""
    fitted = [run for name, run in named.items() if name != LEFT_OUT]
    model = dynid.identify_servo(fitted, validation=named[LEFT_OUT])
    print("| recording | dynid | MJCF | without the surface: dynid | Isaac Lab's configuration | USD |")
    print("|---|---|---|---|---|---|")
    for name, run in named.items():
        files = replays(model, run)
        ratios = [f"{1e3 * each.error:.1f} ({each.error / each.model_error:.2f})" for each in files]
        own = [f"{1e3 * each.model_error:.1f}" for each in files]
        print("| " + " | ".join([name, own[0], ratios[0], own[1], *ratios[1:]]) + " |", flush=True)


def main() -> None:
    """Print a row per file."""
    if sys.argv[1:] == ["so101"]:
        of_real_arm(recordings(Path(os.environ["DYNID_DATA"]) / "so101"))
        return
    run = simulate_servo("so101", duration=30.0, seed=1)
    model = dynid.identify_servo(run, validation=simulate_servo("so101", duration=6.0, seed=3))
    print("| file | values nearest to the model | values as identified | dynid | not in the file: moves the model by |")
    print("|---|---|---|---|---|")
    for file in replays(model, simulate_servo("so101", duration=30.0, seed=2)):
        errors = (file.error, file.identified_error, file.model_error)
        lost = ", ".join(f"{word}: {1e3 * error:.2g}" for word, error in file.left_out.items())
        print("| " + " | ".join([file.file, *(f"{1e3 * error:.2g}" for error in errors), lost]) + " |", flush=True)


if __name__ == "__main__":
    main()
