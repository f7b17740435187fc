"""A servo model of a real SO-101: roll-out errors on recordings that it was not identified from.

Ten recordings of SAGE (Apache-2.0) in `DYNID_DATA/so101`; each is left out once, and rolled out on its commands alone.
Errors are means of the absolute error after the first second [mrad]; "delay and lag" is fitted to the other nine, too.

`python -m studies.servo.so101` takes about ten minutes; `python -m studies.servo.so101 2` leaves out every fifth.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from daq.recording.recording import Recording
from daq.robot.loader import load_robot
from ident.servo.identify import identify_servo

JOINTS = 5
"""Without the jaw, whose recorded position is scaled."""


def recordings(folder: Path) -> dict[str, Recording]:
    """All recordings of the arm, by name."""
    robot = load_robot("so101")
    return {path.stem: import_file(path, robot, ImportChoices()) for path in sorted(folder.glob("*.npz"))}


def main() -> None:
    """Print a row per recording."""
    folder = Path(os.environ["DYNID_DATA"]) / "so101"
    named = recordings(folder)
    every = list(named.values())
    count = int(sys.argv[1]) if len(sys.argv) > 1 else len(every)
    robot = load_robot("so101")
    print("| left out | " + " | ".join(robot.robot.joint_names[:JOINTS]) + " | mean | command | delay and lag |")
    print("|---|" + "---|" * (JOINTS + 3))
    rows = []
    for number in np.unique(np.linspace(0, len(every) - 1, count).astype(int)).tolist():
        rest = [recording for index, recording in enumerate(every) if index != number]
        model = identify_servo(rest, [every[number]], robot, {}, lambda step: None)
        shown = model.result.validation
        assert shown is not None
        rows.append([shown.rollout_error, shown.references.command, shown.references.delay_and_lag])
        own, command, lagged = (1e3 * np.array(row[:JOINTS]) for row in rows[-1])
        cells = [*own, own.mean(), command.mean(), lagged.mean()]
        print(f"| {list(named)[number]} | " + " | ".join(f"{cell:.1f}" for cell in cells) + " |", flush=True)
    mean = 1e3 * np.mean(np.array(rows)[:, :, :JOINTS], axis=0)
    cells = [*mean[0], mean[0].mean(), mean[1].mean(), mean[2].mean()]
    print("| **mean** | " + " | ".join(f"{cell:.1f}" for cell in cells) + " |")


if __name__ == "__main__":
    main()
