"""The example that prints the gains' errors runs as it stands."""

from __future__ import annotations

import importlib.util
from pathlib import Path


def test_gains_example_runs(capsys):
    path = Path(__file__).resolve().parents[4] / "studies" / "payload" / "gains.py"
    spec = importlib.util.spec_from_file_location("gains", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.main(seeds=1)
    out = capsys.readouterr().out
    assert "wrist_3_joint" in out
    assert "all gains of the file 10 % too high" in out
    assert "identify them with dynid gains" in out
