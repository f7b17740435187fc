"""SR400 .4.3 point 7 with a simulated arm: joints locked, the wrist's torques only, merged; against one experiment."""

from __future__ import annotations

import numpy as np
import pytest
from sampled_arm import sampled

from daq.robot.loader import load_robot
from studies.papers import two_experiments

pytestmark = pytest.mark.usefixtures("estimates_alone", "stated_friction")


@pytest.mark.slow
def test_two_experiments_give_the_arm_and_know_whether_they_agree(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(two_experiments, "load_robot", lambda name: sampled(load_robot(name), 125.0))
    found = two_experiments.main(1, 16)
    assert len(found.names) == 56
    assert np.all(np.isfinite(found.values))
    inside = np.abs(found.values - found.truth) < 1.96 * found.std
    assert np.all(np.mean(inside, axis=(1, 2)) > 0.75)  # of one seed, whose errors hang together
    assert np.max(np.abs(found.values - found.truth) / found.std) < 5.0
    # All torques of both experiments tell more than those that the paper's way picks.
    assert np.mean(found.std[4] <= 1.05 * found.std[2]) > 0.8
    assert found.agree == [True]
    assert found.loaded_agree == [False]
    assert "chi-square" in capsys.readouterr().out
