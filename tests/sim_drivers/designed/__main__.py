"""`python tests/sim_drivers/designed`: the motions of the demonstration's tests, as `dynid demo` designs them."""

from __future__ import annotations

from pathlib import Path

from daq.robot.loader import load_robot
from ident.excite.choices import DesignChoices
from sim_drivers.rtde.demo import LIMIT_MARGIN, RAMP, _excitation

if __name__ == "__main__":
    choices = DesignChoices(period=8.0, periods=1, ramp=RAMP, margin=LIMIT_MARGIN)
    for seed in (1, 2):
        text = _excitation(load_robot("ur5e"), choices, seed, print)
        Path(__file__).with_name(f"{seed}.yaml").write_text(text, encoding="utf-8")
