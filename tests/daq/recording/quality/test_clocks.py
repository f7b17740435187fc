"""Offset and drift are recovered from stamps whose delays are random but never negative."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated_clock import SimulatedClock

from daq.recording.quality.clocks import REPORT_PERIOD, ClockFit, ClockLog, describe_clock
from drivers.streams import Batch


def delays(kind: str, generator: np.random.Generator, count: int) -> np.ndarray:
    match kind:
        case "exponential":
            return generator.exponential(2e-4, count)
        case "uniform":
            return generator.uniform(0.0, 1e-3, count)
        case "gamma":
            return generator.gamma(4.0, 1e-4, count)
        case "bursts":
            busy = np.sin(np.arange(count) / 150.0) > 0.0
            return generator.exponential(1e-4, count) + busy * generator.exponential(3e-3, count)
        case "growing":
            return generator.exponential(1e-4, count) * np.linspace(1.0, 6.0, count)
    raise ValueError(kind)


def stamps(seed: int, kind: str, rate: float, span: float, offset: float, drift: float, start: float = 100.0):
    generator = np.random.default_rng(seed)
    time = start + np.arange(int(span * rate)) / rate
    return time, time + offset + drift * (time - start) + delays(kind, generator, len(time))


@pytest.mark.parametrize("kind", ["exponential", "uniform", "gamma", "bursts", "growing"])
@settings(max_examples=15)
@given(
    seed=st.integers(0, 2**31),
    offset=st.floats(-1e6, 1e6),
    drift=st.floats(-5e-4, 5e-4),
    rate=st.sampled_from([5.0, 100.0, 500.0]),
    block=st.integers(1, 500),
)
def test_offset_and_drift_are_recovered(
    kind: str, seed: int, offset: float, drift: float, rate: float, block: int
) -> None:
    span = 60.0 if rate < 100 else 10.0
    time, host = stamps(seed, kind, rate, span, offset, drift)
    fit = ClockFit()
    for first in range(0, len(time), block):
        fit.add(time[first : first + block], host[first : first + block])
    found = fit.estimate()
    assert found is not None
    true = offset + drift * (found.reference - 100.0)
    # Stated errors are for 95 % of cases; of many draws some lie outside, but none far.
    assert found.offset >= true - 4.0 * found.offset_error - 1e-8
    assert abs(found.offset - true) <= 4.0 * found.offset_error + 1e-8
    assert abs(found.drift - drift) <= 4.0 * found.drift_error + 1e-8
    assert abs(found.drift - drift) < 5e-5  # and they are of use: the delays' spread over the span would be 1e-4


@pytest.mark.parametrize("kind", ["exponential", "uniform", "gamma", "bursts", "growing"])
def test_stated_errors_hold_in_most_cases(kind: str) -> None:
    inside = []
    for seed in range(40):
        fit = ClockFit()
        fit.add(*stamps(seed, kind, 100.0, 20.0, 3.0, 1e-4))
        found = fit.estimate()
        assert found is not None
        true = 3.0 + 1e-4 * (found.reference - 100.0)
        inside.append(abs(found.offset - true) <= found.offset_error + 1e-9)
        inside.append(abs(found.drift - 1e-4) <= found.drift_error + 1e-12)
    assert np.mean(inside) >= 0.9


@given(st.lists(st.tuples(st.floats(), st.floats()), max_size=50), st.integers(1, 50))
def test_any_stamps_are_survived(pairs: list[tuple[float, float]], block: int) -> None:
    fit = ClockFit()
    time, host = np.array([pair[0] for pair in pairs]), np.array([pair[1] for pair in pairs])
    with np.errstate(all="ignore"):
        for first in range(0, len(pairs), block):
            fit.add(time[first : first + block], host[first : first + block])
        fit.estimate()


def test_a_clock_that_starts_again_is_a_new_clock() -> None:
    fit = ClockFit()
    fit.add(*stamps(1, "uniform", 100.0, 20.0, 50.0, 0.0))
    fit.add(*stamps(2, "uniform", 100.0, 20.0, 170.0, 0.0, start=1.0))
    found = fit.estimate()
    assert found is not None
    assert found.offset == pytest.approx(170.0, abs=1e-3)
    assert 18.9 < found.span < 20.0


def test_too_little_says_nothing() -> None:
    fit = ClockFit()
    assert fit.estimate() is None
    fit.add(*stamps(1, "uniform", 500.0, 0.5, 0.0, 0.0))
    assert fit.estimate() is None


def test_a_session_reports_once_a_minute_and_at_its_end(clock: SimulatedClock) -> None:
    log = ClockLog(clock)
    for second in range(150):
        time, host = stamps(second, "uniform", 100.0, 1.0, 7.0, 0.0, start=float(second))
        log.add(Batch("joints", time, host))
        log.add(Batch("thermometer", host, host))
        clock.sleep(1.0)
        said = log.due()
        assert bool(said) == (second + 1.0 in (REPORT_PERIOD, 2 * REPORT_PERIOD))
    joints, thermometer = log.messages()
    assert joints.startswith("clock of joints: offset 7.0000")
    assert " ppm ± " in joints
    assert thermometer == "clock of thermometer: the host's own, stamped on arrival"
    fit = ClockFit()
    fit.add(*stamps(1, "uniform", 500.0, 60.0, 3.0, 2e-5))
    estimate = fit.estimate()
    assert estimate is not None
    assert "drift +20" in describe_clock("arm", estimate) or "drift +19.9" in describe_clock("arm", estimate)
    assert estimate.host_time(130.0) == pytest.approx(133.0 + 2e-5 * 30.0, abs=1e-5)
