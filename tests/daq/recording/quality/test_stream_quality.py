"""Rate, jitter, lost samples, duplicates and gaps of stamps that were made for it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq.recording.quality.stream_quality import Gap, stream_quality


def test_an_even_stream():
    quality = stream_quality(5.0 + np.arange(501) / 500)
    assert quality.samples == 501
    assert quality.duration == pytest.approx(1.0)
    assert quality.rate_hz == pytest.approx(500.0)
    assert quality.jitter_ms == pytest.approx(0.0, abs=1e-9)
    assert quality.longest_ms == pytest.approx(2.0)
    assert (quality.lost, quality.duplicates, quality.gaps) == (0, 0, ())


def test_jitter_is_the_rms_deviation_of_the_intervals():
    intervals = np.tile([0.0098, 0.0100, 0.0102], 100)
    quality = stream_quality(np.concatenate([[0.0], np.cumsum(intervals)]))
    assert quality.rate_hz == pytest.approx(100.0)
    assert quality.jitter_ms == pytest.approx(0.2 * math.sqrt(2 / 3))


def test_lost_samples_and_where():
    time = np.delete(np.arange(1000) / 100, [200, 500, 501, 502])
    quality = stream_quality(time)
    assert quality.lost == 4
    assert quality.gaps == (Gap(1.99, pytest.approx(0.02), 1), Gap(4.99, pytest.approx(0.04), 3))
    assert quality.rate_hz == pytest.approx(100.0)
    assert quality.jitter_ms == pytest.approx(0.0, abs=1e-9)  # gaps are no jitter
    assert quality.longest_ms == pytest.approx(40.0)


@given(
    lost=st.dictionaries(st.integers(10, 190), st.integers(1, 30), max_size=5),
    period=st.sampled_from([0.001, 0.002, 0.008, 1.0]),
)
def test_every_sample_that_was_taken_out_is_counted(lost, period):
    intervals = np.full(200, period)
    for place, count in lost.items():
        intervals[place] = (count + 1) * period
    quality = stream_quality(np.concatenate([[0.0], np.cumsum(intervals)]))
    assert quality.lost == sum(lost.values())
    assert [gap.lost for gap in quality.gaps] == [count for _, count in sorted(lost.items())]
    assert quality.samples + quality.lost == round(quality.duration / period) + 1


def _arrivals(sent: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Stamps of a busy computer: what was sent while it did something else arrives at once, 10 µs apart."""
    pauses = generator.choice([0.0003, 0.004, 0.03], size=4 * len(sent), p=[0.5, 0.45, 0.05])
    awake = np.cumsum(pauses * generator.uniform(0.5, 1.5, len(pauses)))
    arrived = awake[np.searchsorted(awake, sent)]
    for index in range(1, len(arrived)):
        arrived[index] = max(arrived[index], arrived[index - 1] + 1e-5)
    return arrived


@pytest.mark.parametrize("rate", [100.0, 250.0, 500.0])
@pytest.mark.parametrize("seed", range(3))
def test_bursts_of_arrivals_are_neither_a_rate_nor_a_loss(rate, seed):
    """One over the median interval is 821 Hz of 500 Hz, and the pauses are 1,863 samples, where none was lost."""
    generator = np.random.default_rng(seed)
    sent = np.arange(int(20 * rate)) / rate
    quality = stream_quality(_arrivals(sent, generator))
    assert quality.rate_hz == pytest.approx(rate, rel=0.01)
    assert quality.lost <= 1e-3 * len(sent)  # nothing comes after the last pauses that could make up for them
    # A second in which nothing came is a loss nevertheless.
    quality = stream_quality(_arrivals(sent[(sent < 9.0) | (sent >= 10.0)], generator))
    assert quality.lost == pytest.approx(rate, rel=0.15)
    assert quality.rate_hz == pytest.approx(rate, rel=0.01)


@given(st.integers(3, 8), st.floats(0.02, 0.45), st.sampled_from([0.0, 1e-6, 1e-5]))
def test_devices_that_report_one_after_the_other_lose_nothing(devices, share, jitter):
    """Within less than half of a cycle; the pauses may be whole multiples of the time between two devices."""
    apart = share / 125.0 / devices
    noise = jitter * np.random.default_rng(devices).standard_normal((500, devices))
    time = np.arange(500)[:, None] / 125.0 + apart * np.arange(devices) + noise
    quality = stream_quality(np.sort(time.ravel()))
    assert quality.rate_hz == pytest.approx(125.0 * devices, rel=0.02)
    assert quality.lost <= devices  # of the last cycle, after which nothing comes


@pytest.mark.parametrize("jitter", [0.05, 0.2])
def test_losses_between_jittering_stamps_are_counted(jitter):
    generator = np.random.default_rng(1)
    time = (np.arange(5000) + jitter * generator.uniform(-1.0, 1.0, 5000)) / 250.0
    gone = np.sort(generator.choice(np.arange(100, 4900), 40, replace=False))
    quality = stream_quality(np.delete(time, gone))
    assert quality.rate_hz == pytest.approx(250.0, rel=0.01)
    assert quality.lost == 40


def test_duplicates_and_stamps_that_go_back():
    quality = stream_quality(np.array([0.0, 0.01, 0.01, 0.02, 0.015, 0.03, 0.04]))
    assert quality.duplicates == 2
    assert stream_quality(np.zeros(5)).duplicates == 4
    assert math.isnan(stream_quality(np.zeros(5)).rate_hz)


@pytest.mark.parametrize("count", [0, 1])
def test_too_short_for_a_rate(count):
    quality = stream_quality(np.arange(float(count)))
    assert quality.samples == count
    assert math.isnan(quality.rate_hz)
    assert math.isnan(quality.jitter_ms)


@given(st.lists(st.floats(-1e9, 1e9), max_size=40))
def test_any_stamps_give_figures(stamps):
    quality = stream_quality(np.array(stamps))
    assert quality.samples == len(stamps)
    assert quality.lost >= 0
    assert quality.lost == sum(gap.lost for gap in quality.gaps)
    assert 0 <= quality.duplicates <= max(0, len(stamps) - 1)
    assert all(gap.duration > 0 for gap in quality.gaps)


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), max_size=20))
def test_stamps_that_are_no_numbers_do_not_crash_it(stamps):
    assert stream_quality(np.array(stamps)).samples == len(stamps)
