"""Zero-phase filters against scipy, and block by block against the whole."""

from __future__ import annotations

from decimal import Decimal, localcontext

import numpy as np
import pytest
import scipy.signal
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.core.errors import UsageError
from ident.signals.filters import (
    StreamedFilter,
    ZeroPhaseFilter,
    butterworth,
    chebyshev_decimation,
    no_filter,
    unit_gain,
)

FILTERS = [
    chebyshev_decimation(2),
    chebyshev_decimation(5, order=5),
    chebyshev_decimation(10),
    chebyshev_decimation(40),
    unit_gain(chebyshev_decimation(4)),
    butterworth(8, 125, factor=4),
    butterworth(8, 1000, factor=20),
    butterworth(30, 500, order=3, factor=7),
    butterworth(50, 200, order=5),
    butterworth(50, 200, order=1, factor=3),
    butterworth(90, 200, order=2),
]


def walk(rows: int, samples: int, seed: int = 0) -> np.ndarray:
    return np.cumsum(np.random.default_rng(seed).standard_normal((rows, samples)), axis=1)


def scipy_filtered(zero_phase: ZeroPhaseFilter, rows: np.ndarray) -> np.ndarray:
    return scipy.signal.sosfiltfilt(zero_phase.sos.copy(), rows, axis=1)[:, :: zero_phase.factor]


@each("zero_phase", FILTERS)
def test_apply_equals_sosfiltfilt(zero_phase: ZeroPhaseFilter) -> None:
    for samples in (31, 95, 96, 97, 1003, 6000):
        rows = walk(3, samples)
        ours = zero_phase.apply(rows)
        assert ours.shape == (3, -(-samples // zero_phase.factor))
        np.testing.assert_allclose(ours, scipy_filtered(zero_phase, rows), rtol=0, atol=1e-12 * np.abs(rows).max())


@each("factor", [2, 5, 10])
def test_chebyshev_decimation_equals_scipy_decimate(factor: int) -> None:
    rows = walk(4, 3001)
    expected = scipy.signal.decimate(rows, factor, axis=1)
    ours = chebyshev_decimation(factor).apply(rows)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-12 * np.abs(rows).max())


def test_low_cutoff_is_closer_to_fifty_digits_than_scipy() -> None:
    zero_phase = butterworth(1, 5000, order=2)
    row = walk(1, 400)
    with localcontext() as context:
        context.prec = 50
        exact = decimal_filtfilt(zero_phase, row[0])
    ours = np.abs(zero_phase.apply(row)[0] - exact).max()
    assert ours < 1e-12 * np.abs(row).max()
    assert ours < np.abs(scipy_filtered(zero_phase, row)[0] - exact).max()


def decimal_filtfilt(zero_phase: ZeroPhaseFilter, row: np.ndarray) -> np.ndarray:
    pad = zero_phase.extension
    x = [Decimal(float(value)) for value in row]
    values = [2 * x[0] - v for v in x[pad:0:-1]] + x + [2 * x[-1] - v for v in x[-2 : -pad - 2 : -1]]
    for _ in range(2):
        for section in zero_phase.sos.tolist():
            b0, b1, b2, _, a1, a2 = (Decimal(value) for value in section)
            settled = (b0 + b1 + b2) / (1 + a1 + a2) * values[0]
            second = b2 * values[0] - a2 * settled
            first = b1 * values[0] - a1 * settled + second
            filtered = []
            for u in values:
                y = b0 * u + first
                first, second = b1 * u - a1 * y + second, b2 * u - a2 * y
                filtered.append(y)
            values = filtered
        values.reverse()
    return np.array([float(value) for value in values[pad:-pad]])


@settings(max_examples=60)
@given(data=st.data())
def test_streamed_equals_whole(data: st.DataObject) -> None:
    zero_phase = data.draw(st.sampled_from([no_filter(3), *FILTERS]))
    blocks = data.draw(st.lists(st.sampled_from([0, 1, 2, 7, 29, 96, 97, 300, 1024, 4096]), min_size=1, max_size=12))
    blocks *= data.draw(st.sampled_from([1, 1, 3]))
    rows = walk(2, sum(blocks), seed=len(blocks))
    streamed = StreamedFilter(zero_phase, 2)
    parts, start = [], 0
    for size in blocks:
        parts.append(streamed.push(rows[:, start : start + size]))
        start += size
    parts.append(streamed.finish())
    whole = zero_phase.apply(rows)
    ours = np.concatenate(parts, axis=1)
    assert ours.shape == whole.shape
    if rows.size:
        np.testing.assert_allclose(ours, whole, rtol=0, atol=1e-11 * np.abs(rows).max())


def test_pushed_block_may_be_overwritten_afterwards() -> None:
    zero_phase, rows = butterworth(8, 500, factor=5), walk(3, 5000)
    streamed, scratch, parts = StreamedFilter(zero_phase, 3), np.empty((3, 250)), []
    for start in range(0, 5000, 250):
        scratch[:] = rows[:, start : start + 250]
        parts.append(streamed.push(scratch))
        scratch[:] = np.nan
    parts.append(streamed.finish())
    np.testing.assert_allclose(np.concatenate(parts, axis=1), zero_phase.apply(rows), atol=1e-10)


def test_stream_hands_out_early_and_holds_little() -> None:
    zero_phase = chebyshev_decimation(10)
    streamed = StreamedFilter(zero_phase, 4)
    rows = walk(4, 4096)
    pushed = handed_out = 0
    for _ in range(40):
        pushed += 4096
        handed_out += streamed.push(rows).shape[1]
        assert pushed - 10 * handed_out < 3 * zero_phase.settling_samples() + 4096


def test_stream_is_not_used_after_its_end() -> None:
    streamed = StreamedFilter(butterworth(8, 500), 2)
    with pytest.raises(ValueError, match="2 rows"):
        streamed.push(np.zeros((3, 5)))
    streamed.finish()
    with pytest.raises(ValueError, match="finished"):
        streamed.push(np.zeros((2, 5)))
    with pytest.raises(ValueError, match="finished"):
        streamed.finish()


@each("zero_phase", FILTERS)
def test_signals_shorter_than_the_extension(zero_phase: ZeroPhaseFilter) -> None:
    for samples in (1, 2, 3, 5, 12):
        rows = walk(2, samples)
        pad = min(zero_phase.extension, samples - 1)
        expected = scipy.signal.sosfiltfilt(zero_phase.sos.copy(), rows, axis=1, padlen=pad)[:, :: zero_phase.factor]
        np.testing.assert_allclose(zero_phase.apply(rows), expected, atol=1e-12 * np.abs(rows).max())


@each("zero_phase", FILTERS)
def test_constant_and_ramp(zero_phase: ZeroPhaseFilter) -> None:
    rows = np.stack([np.full(900, 3.0), np.linspace(-1, 5, 900)])
    filtered = zero_phase.apply(rows)
    gain = zero_phase.gain_at_rest()
    np.testing.assert_allclose(filtered[0], 3.0 * gain, rtol=1e-11)
    middle = slice(filtered.shape[1] // 3, filtered.shape[1] // 2)
    if zero_phase.settling_samples(1e-4) < 300:  # else the ends reach the middle
        np.testing.assert_allclose(filtered[1][middle], gain * rows[1][:: zero_phase.factor][middle], rtol=0.01)


def test_gain_at_rest() -> None:
    assert butterworth(8, 1000).gain_at_rest() == pytest.approx(1, abs=1e-9)
    assert chebyshev_decimation(5, order=5).gain_at_rest() == pytest.approx(1, abs=1e-9)
    # Even order: two directions of 0.05 dB ripple.
    assert chebyshev_decimation(10).gain_at_rest() == pytest.approx(10 ** (-0.1 / 20), rel=1e-9)
    assert unit_gain(chebyshev_decimation(10)).gain_at_rest() == pytest.approx(1, abs=1e-12)
    assert unit_gain(no_filter()).gain_at_rest() == 1


@each("frequency", [1.0, 4.0, 8.0, 16.0])
def test_zero_phase_and_gain_of_a_sinusoid(frequency: float) -> None:
    rate, cutoff = 1000.0, 8.0
    instants = np.arange(20000) / rate
    signal = np.sin(2 * np.pi * frequency * instants)
    filtered = butterworth(cutoff, rate).apply(signal[None])[0]
    inner = slice(3000, 17000)  # whole periods
    quadrature = np.cos(2 * np.pi * frequency * instants)
    gain = 2 * np.mean(filtered[inner] * signal[inner])
    warped = np.tan(np.pi * frequency / rate) / np.tan(np.pi * cutoff / rate)  # of the bilinear transform
    assert gain == pytest.approx(1 / (1 + warped**8), rel=1e-5)
    assert abs(2 * np.mean(filtered[inner] * quadrature[inner])) < 1e-9


def test_impulse_response_is_symmetric() -> None:
    impulse = np.zeros((1, 4001))
    impulse[0, 2000] = 1
    response = butterworth(20, 1000).apply(impulse)[0]
    np.testing.assert_allclose(response, response[::-1], atol=1e-16)
    assert np.argmax(response) == 2000


@each("zero_phase", FILTERS)
def test_settling(zero_phase: ZeroPhaseFilter) -> None:
    settled = zero_phase.settling_samples()
    impulse = np.zeros(4 * settled + 50)
    impulse[0] = 1
    memory = np.abs(scipy.signal.sosfilt(zero_phase.sos.copy(), impulse))
    assert memory[settled + 30 :].max() <= 3e-13 * memory.max()


def test_settling_of_decimation_by_ten() -> None:
    assert 1500 < chebyshev_decimation(10).settling_samples() < 1700


def test_sections_are_frozen() -> None:
    with pytest.raises(ValueError, match="read-only"):
        butterworth(8, 100).sos[0, 0] = 1


def test_descriptions() -> None:
    assert butterworth(8, 125, factor=4).description == "zero-phase Butterworth 4, 8 Hz, every 4th sample kept"
    assert butterworth(8, 125).description == "zero-phase Butterworth 4, 8 Hz"
    assert "every 21st sample" in no_filter(21).description
    assert "every 12th sample" in no_filter(12).description


@each(
    "make",
    [
        lambda: butterworth(0, 100),
        lambda: butterworth(-1, 100),
        lambda: butterworth(50, 100),
        lambda: butterworth(float("nan"), 100),
        lambda: butterworth(5, 100, order=0),
        lambda: butterworth(5, 100, factor=0),
        lambda: chebyshev_decimation(0),
        lambda: chebyshev_decimation(2, order=0),
        lambda: no_filter(-1),
    ],
)
def test_bad_design_is_refused(make: object) -> None:
    with pytest.raises(UsageError):
        make()  # type: ignore[operator]
