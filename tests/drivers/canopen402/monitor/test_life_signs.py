"""Missing rows have one of three causes: no SYNC was sent, the bus was not read, or a drive did not answer."""

from __future__ import annotations

from each import each

from drivers.canopen402.monitor.life_signs import Silence
from drivers.canopen402.protocol.objects import TPDO_BASES

NOW, LIMIT = 100.0, 0.05


@each(
    ("drained", "last_sync", "answers", "said"),
    [
        (0.005, 0.002, (0.002, 0.002), ""),
        (0.005, 0.002, (0.002, 0.1), "no answer to SYNC of elbow (node 2) for 0.09 s"),
        (0.005, 0.002, (0.1, 0.1), "no answer to SYNC of any drive for 0.09 s"),
        (0.04, 0.002, (0.1, 0.1), "the bus was not read for 0.04 s"),
        (0.04, 0.06, (0.1, 0.1), "no SYNC sent for 0.06 s"),
    ],
)
def test_the_cause_is_told(drained: float, last_sync: float, answers: tuple[float, float], said: str) -> None:
    """All times are ages [s]."""
    latest = {
        base + node: (NOW - age, base + node, b"")
        for base in TPDO_BASES
        for node, age in zip((1, 2), answers, strict=True)
    }
    silence = Silence(("shoulder", "elbow"), (1, 2), latest)
    assert silence.explain(NOW, NOW - drained, NOW - last_sync, LIMIT) == said
