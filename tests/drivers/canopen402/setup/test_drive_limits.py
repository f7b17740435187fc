"""Limits that drives tell of their own: as those of the joints; what is odd about a stop; no rounded period."""

from __future__ import annotations

import math

import numpy as np
import pytest
from canopen_bench import bench
from scripted_drives import ScriptedDrive

from drivers.core.errors import ConnectionFailedError

COUNTS = 409600 / (2 * math.pi)
TOLD = {
    (0x6065, 0): 10_000,
    (0x6072, 0): 2500,
    (0x607C, 0): 0,
    (0x607D, 1): -100_000,
    (0x607D, 2): 200_000,
    (0x607F, 0): 150_000,
    (0x605A, 0): 2,
    (0x6085, 0): 500_000,
}


def drives(*changed: dict[tuple[int, int], int]) -> list[ScriptedDrive]:
    """Three drives that tell limits; changes one by one."""
    more = [*changed, {}, {}, {}][:3]
    return [ScriptedDrive(node, objects=TOLD | more[node - 1]) for node in (1, 2, 3)]


@pytest.mark.parametrize("mode", ["position", "none"])
def test_limits_of_drives_are_those_of_the_joints_and_nothing_is_written(mode: str) -> None:
    home, free = {(0x607C, 0): 1000}, {(0x607D, 1): 0, (0x607D, 2): 0, (0x6072, 0): 65535, (0x6065, 0): 2**32 - 1}
    nodes: dict[str, dict[str, object]] = {"lift": {"direction": -1, "zero": 0.5}}
    with bench(drives({}, home, free), nodes=nodes, begin="open", mode=mode) as one:
        own = one.driver.device_limits()
        ends = np.array([[-100_000, 200_000], [-199_000, 101_000], [math.nan, math.nan]]) / COUNTS
        ends[1] += 0.5
        np.testing.assert_allclose(np.array([own.lowest, own.highest]).T, ends)
        np.testing.assert_allclose(own.velocity, 150_000 / COUNTS)
        np.testing.assert_allclose(own.torque, [125.0, 125.0, math.nan])
        assert own.following_error is not None
        assert own.stopping is not None
        np.testing.assert_allclose(own.following_error, [10_000 / COUNTS, 10_000 / COUNTS, math.nan])
        np.testing.assert_allclose(own.stopping, 500_000 / COUNTS)
        written = {data[1:4] for identifier, data in one.bus.seen if identifier > 0x600 and data[0] & 0xE0 == 0x20}
        assert not {index.to_bytes(2, "little") + bytes([sub]) for index, sub in TOLD} & written
        assert one.driver.cautions() == (
            "elbow: the drive supervises no following error of its own (0x6065 does not exist, or is off)",
        )


def test_drives_that_tell_nothing_limit_nothing_and_that_is_said() -> None:
    with bench(begin="open") as one:
        own = one.driver.device_limits()
        assert np.isnan([own.lowest, own.highest, own.velocity, own.torque, own.following_error, own.stopping]).all()
        said = one.driver.cautions()
        assert [line.split(":")[0] for line in said] == ["pan, lift, elbow"] * 2
        assert "0x605A does not exist" in said[0]


@pytest.mark.parametrize(
    ("changed", "said", "ramp"),
    [
        ({(0x605A, 0): 0}, "quick stop option (0x605A) 0: its voltage is cut, and the arm coasts", math.nan),
        ({(0x605A, 0): -3}, "quick stop option (0x605A) -3: what that means is the manufacturer's choice", 500_000),
        ({(0x6085, 0): 0}, "the deceleration of its quick stop is 0", 0.0),
        ({(0x605A, 0): 5, (0x6084, 0): 7000}, None, 7000),
        ({(0x605A, 0): 3}, None, math.nan),
    ],
)
def test_what_a_quick_stop_does_is_known_before_a_motion(
    changed: dict[tuple[int, int], int], said: str | None, ramp: float
) -> None:
    with bench(drives({}, changed), begin="open") as one:
        assert one.driver.cautions() == (() if said is None else (f"lift: {said}",))
        assert one.driver.device_limits().stopping[1] * COUNTS == pytest.approx(ramp, nan_ok=True)  # type: ignore[index]


@pytest.mark.parametrize(("rate", "fits"), [(250.0, True), (1000 / 3, True), (300.0, False), (128.0, False)])
def test_a_period_that_a_drive_would_round_is_refused(rate: float, fits: bool) -> None:
    period = {(0x60C2, 1): 0, (0x60C2, 2): 0}
    with bench(drives(period), begin="closed", sync_rate=rate) as one:
        if fits:
            one.driver.open()
            return
        with pytest.raises(ConnectionFailedError, match="does not fit into 0x60C2:1") as caught:
            one.driver.open()
        first = float(caught.value.hint.split()[3])
    with bench(drives(period), begin="open", sync_rate=first):
        pass
