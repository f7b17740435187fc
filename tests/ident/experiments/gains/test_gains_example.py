"""The example that prints the gains' errors runs as it stands."""

from __future__ import annotations

from studies.payload import gains


def test_gains_example_runs(capsys):
    gains.main(seeds=1)
    out = capsys.readouterr().out
    assert "wrist_3_joint" in out
    assert "all gains of the file 10 % too high" in out
    assert "identify them with dynid gains" in out
