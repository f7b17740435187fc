"""From a recording to segments, step by step and as a whole."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from each import each

from drivers.core.errors import DataError, InputError, UsageError
from ident.signals.cutoffs import choose_cutoffs
from ident.signals.joint_signals import JointSignals
from ident.signals.options import PreprocessChoices
from ident.signals.pipeline import prepare as prepare_signals
from ident.signals.prepared import Prepared, Segment
from ident.signals.segments import default_rest_velocity, motion_band, moving_mask

JOINTS = ("base", "elbow", "wrist", "hand", "j5", "j6", "j7")


def prepare(
    time: np.ndarray,
    position: np.ndarray,
    torque: np.ndarray,
    choices: PreprocessChoices,
    velocity: np.ndarray | None = None,
) -> Prepared:
    """The pipeline over signals without a recording."""
    names = JOINTS[: position.shape[1]]
    return prepare_signals(JointSignals("", names, time, position, torque, "given", velocity), choices)


PEAK = 0.8  # rad/s, of each joint's slowest harmonic


def fourier(time: np.ndarray, joints: int = 3, fundamental: float = 0.1, seed: int = 1) -> tuple[np.ndarray, ...]:
    """(N, n) position, velocity, acceleration of a periodic excitation with five harmonics."""
    rng = np.random.default_rng(seed)
    shape = (len(time), joints)
    position, velocity, acceleration = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for harmonic in range(1, 6):
        omega = 2 * np.pi * fundamental * harmonic
        for joint in range(joints):
            amplitude = PEAK / omega / harmonic
            phase = omega * time + rng.uniform(0, 2 * np.pi)
            position[:, joint] += amplitude * np.sin(phase)
            velocity[:, joint] += amplitude * omega * np.cos(phase)
            acceleration[:, joint] -= amplitude * omega**2 * np.sin(phase)
    return position, velocity, acceleration


@pytest.fixture(scope="module")
def recording() -> tuple[np.ndarray, ...]:
    """Time, position, torque, velocity: 20 s at 200 Hz; the torque follows the position 7.5 ms late."""
    time = 100.0 + np.arange(4000) / 200
    position, velocity, _ = fourier(time)
    _, _, late = fourier(time - 0.0075)
    return time, position, late, velocity


@pytest.mark.parametrize("rate", [125.0, 500.0, 2000.0])
@pytest.mark.parametrize("noise", [0.0, 1e-5, 1e-4, 1e-3])
@pytest.mark.parametrize("fundamental", [0.05, 0.1])
def test_band_of_an_excitation(rate: float, noise: float, fundamental: float) -> None:
    time = np.arange(int(2 / fundamental * rate)) / rate
    position = fourier(time, fundamental=fundamental)[0].T
    position = position + noise * np.random.default_rng(0).standard_normal(position.shape)
    assert 3 * fundamental <= motion_band(position, rate) <= 8 * fundamental


def test_a_still_joint_does_not_widen_the_band() -> None:
    time = np.arange(10_000) / 500
    position = fourier(time)[0].T
    noisy = position + 1e-6 * np.random.default_rng(0).standard_normal(position.shape)
    noisy[2] -= position[2]
    assert motion_band(noisy, 500) < 1
    assert motion_band(np.ones((2, 500)), 100) == 0
    assert motion_band(np.zeros((2, 3)), 100) == 0


def test_moving_mask() -> None:
    velocity = np.zeros((2, 1000))
    velocity[0, 300:500] = 1
    velocity[1, 510:700] = -1
    moving = moving_mask(velocity, 100, 0.01)
    expected = np.zeros(1000, dtype=bool)
    expected[300:700] = True  # the 0.1 s between are a turning point
    np.testing.assert_array_equal(moving, expected)
    assert moving_mask(np.ones((2, 10)), 100, 0.01).all()
    assert not moving_mask(np.zeros((2, 100)), 100, 0.01).any()
    assert default_rest_velocity(np.zeros((1, 5))) == pytest.approx(1e-3)
    assert default_rest_velocity(np.full((1, 5), -2.0)) == pytest.approx(0.01)


@each("part", [0.0, 0.01, 0.1, 0.5, 1.0])
@each("rate", [25.0, 125.0, 500.0, 1000.0, 5000.0])
def test_default_cutoffs_fit_motion_and_rate(part: float, rate: float) -> None:
    band = part * min(20.0, rate / 5)  # motion_band looks no further
    cutoffs = choose_cutoffs(band, rate, PreprocessChoices())
    assert cutoffs.torque < cutoffs.position <= 0.4 * rate
    assert cutoffs.position >= min(6 * band, 0.4 * rate)
    assert rate / cutoffs.decimate >= 4 * cutoffs.torque
    if cutoffs.decimate > 1:
        assert rate / cutoffs.decimate <= 2 * 4.5 * cutoffs.torque


@pytest.mark.parametrize(("noise", "velocity_error", "acceleration_error"), [(0.0, 5e-4, 5e-4), (1e-5, 5e-3, 2e-2)])
def test_derivatives_are_undistorted_by_the_default_filter(
    recording: tuple[np.ndarray, ...], noise: float, velocity_error: float, acceleration_error: float
) -> None:
    time, position, torque, _ = recording
    noisy = position + noise * np.random.default_rng(0).standard_normal(position.shape)
    (segment,) = prepare(time, noisy, torque, PreprocessChoices()).segments
    _, velocity, acceleration = fourier(segment.time)
    inner = slice(150, -150)
    for ours, truth, error in (
        (segment.velocity, velocity.T, velocity_error),
        (segment.acceleration, acceleration.T, acceleration_error),
    ):
        scale = np.abs(truth).max(axis=1, keepdims=True)
        assert (np.abs(ours - truth)[:, inner] < error * scale).all()
        assert (np.abs(ours - truth) < 2.5e-2 * scale).all()  # the ends too, as the worst of them are left out


def test_ends_without_a_valid_low_pass_are_left_out(recording: tuple[np.ndarray, ...]) -> None:
    time, position, torque, _ = recording
    prepared = prepare(time, position, torque, PreprocessChoices(position_cutoff=10.0))
    (segment,) = prepared.segments
    assert segment.time[0] == pytest.approx(time[0] + 0.2)
    assert segment.time[-1] == pytest.approx(time[-1] - 0.2)
    at = slice(40, 3960)
    np.testing.assert_array_equal(segment.torque, torque[at].T)
    np.testing.assert_allclose(segment.position, position[at].T, atol=1e-3)


def test_resolved_choices_give_the_same_again(recording: tuple[np.ndarray, ...]) -> None:
    time, position, torque, _ = recording
    for kind, decimate in itertools.product(("butterworth", "chebyshev"), (1, 4)):
        choices = PreprocessChoices(filter=kind, position_decimate=decimate)  # type: ignore[arg-type]
        first = prepare(time, position, torque, choices)
        again = prepare(time, position, torque, first.choices)
        assert first.parallel_filter.description == again.parallel_filter.description
        np.testing.assert_array_equal(first.segments[0].acceleration, again.segments[0].acceleration)
        np.testing.assert_array_equal(first.segments[0].used, again.segments[0].used)


def test_delay_brings_torque_and_position_together(recording: tuple[np.ndarray, ...]) -> None:
    time, position, torque, _ = recording
    _, _, aligned = fourier(time)
    for delay, smaller in ((0.0075, True), (0.0, False), (-0.0075, False)):
        (segment,) = prepare(time, position, torque, PreprocessChoices(delay=delay)).segments
        at = np.searchsorted(time, segment.time - 1e-6)
        error = np.abs(segment.torque - aligned.T[:, at]).max()
        assert (error < 1e-4) == smaller


def test_each_joint_may_have_a_delay_of_its_own(recording: tuple[np.ndarray, ...]) -> None:
    time, position, torque, _ = recording
    delays = (0.0075, 0.0, -0.004)
    (segment,) = prepare(time, position, torque, PreprocessChoices(joint_delays=delays)).segments
    for joint, delay in enumerate(delays):
        (alone,) = prepare(time, position, torque, PreprocessChoices(delay=delay)).segments
        _, mine, theirs = np.intersect1d(segment.time, alone.time, return_indices=True)
        assert len(mine) > 0.9 * len(segment.time)
        np.testing.assert_allclose(segment.torque[joint, mine], alone.torque[joint, theirs], atol=1e-9)


def test_delays_for_another_number_of_joints_are_refused(recording: tuple[np.ndarray, ...]) -> None:
    time, position, torque, _ = recording
    with pytest.raises(UsageError, match="2 delays for 3 joints"):
        prepare(time, position, torque, PreprocessChoices(joint_delays=(0.001, 0.002)))
    with pytest.raises(UsageError, match="not a finite number"):
        PreprocessChoices(joint_delays=(0.0, float("nan")))


def test_measured_velocity_only_on_request(recording: tuple[np.ndarray, ...]) -> None:
    time, position, torque, velocity = recording
    wrong = velocity * np.array([1.0, 1.0, 1.1])
    derived = prepare(time, position, torque, PreprocessChoices(), wrong)
    measured = prepare(time, position, torque, PreprocessChoices(measured_velocity=True), wrong)
    difference = velocity_difference(derived)
    rms = np.sqrt(np.mean(velocity[:, 2] ** 2))
    assert difference[2] == pytest.approx(0.1 * rms, rel=0.02)
    assert difference[:2].max() < 0.01 * rms
    np.testing.assert_array_equal(difference, velocity_difference(measured))
    ratio = np.abs(measured.segments[0].velocity[2]).max() / np.abs(derived.segments[0].velocity[2]).max()
    assert ratio == pytest.approx(1.1, rel=0.01)
    assert "wrist" in str(derived)
    assert not velocity_difference(prepare(time, position, torque, PreprocessChoices())).size
    with pytest.raises(UsageError, match="no velocity"):
        prepare(time, position, torque, PreprocessChoices(measured_velocity=True))


def velocity_difference(prepared: Prepared) -> np.ndarray:
    """(n,) RMS difference of recorded and derived velocity [rad/s], from the step that reports it."""
    (settings,) = (step.settings for step in prepared.steps if step.name == "derivatives")
    return np.array([value for key, value in settings.items() if key.startswith("velocity_difference_rms_")])


def inside(segment: Segment) -> np.ndarray:
    """What counts of a segment, without half a second at both ends that the filters may spoil."""
    edge = round(0.5 * segment.rate)
    return segment.used[edge:-edge]


def test_rest_is_left_out(recording: tuple[np.ndarray, ...]) -> None:
    time, position, torque, _ = recording
    still = position.copy()
    still[2000:] = still[2000]
    still += 1e-6 * np.random.default_rng(0).standard_normal(still.shape)
    (segment,) = prepare(time, still, torque, PreprocessChoices()).segments
    start = segment.time[0] + 0.5  # the parallel filter's end does not count
    assert segment.used[(segment.time > start) & (segment.time < 109.9)].mean() > 0.98
    assert not segment.used[segment.time > 110.5].any()
    (segment,) = prepare(time, still, torque, PreprocessChoices(keep_rest=True)).segments
    assert inside(segment).all()
    with pytest.raises(DataError, match="nothing moves"):
        prepare(time, still, torque, PreprocessChoices(start=12))
    kept = prepare(time, still, torque, PreprocessChoices(start=12, keep_rest=True))
    assert inside(kept.segments[0]).all()


def test_gaps_split_and_lost_samples_do_not(recording: tuple[np.ndarray, ...]) -> None:
    time, position, torque, _ = recording
    keep = np.ones(4000, dtype=bool)
    keep[[700, 701, 1500]] = False  # lost: interpolated
    keep[2000:2040] = False  # 0.2 s: a gap
    keep[2045:2080] = False  # leaves five samples between two gaps
    prepared = prepare(time[keep], position[keep], torque[keep], PreprocessChoices())
    first, second = prepared.segments
    ends = 0.5  # at most this much is left out at each end
    assert 100 <= first.time[0] < 100 + ends
    assert 110 - ends < first.time[-1] < 110
    assert 110.4 <= second.time[0] < 110.4 + ends
    assert 120 - ends < second.time[-1] < 120
    assert prepared.irregularity.gaps == 2
    assert "split at 2 gaps" in str(prepared)
    assert "5 samples" in str(prepared)
    (whole,) = prepare(time, position, torque, prepared.choices).segments
    common = min(len(first.time), len(whole.time)) - 200  # the filter still feels the end there
    np.testing.assert_allclose(first.time[:common], whole.time[:common], atol=1e-9)
    np.testing.assert_allclose(first.position[:, :common], whole.position[:, :common], atol=1e-5)


def test_irregular_stamps_give_the_same_as_regular_ones(recording: tuple[np.ndarray, ...]) -> None:
    time = 100 + np.sort(np.concatenate([[0, 20], np.random.default_rng(0).uniform(0, 20, 6000)]))
    position, velocity, _ = fourier(time)
    prepared = prepare(time, position, position, PreprocessChoices())
    inner = slice(300, -300)
    for segment in prepared.segments:
        truth = fourier(segment.time)[1].T
        assert np.abs(segment.velocity - truth)[:, inner].max() < 1e-2 * np.abs(velocity).max()
    assert not prepared.irregularity.regular


def test_repeated_stamps_are_left_out(recording: tuple[np.ndarray, ...]) -> None:
    time, position, torque, _ = (np.repeat(values, 2, axis=0) for values in recording)
    prepared = prepare(time, position, torque, PreprocessChoices())
    once = prepare(*recording[:3], PreprocessChoices())
    np.testing.assert_array_equal(prepared.segments[0].velocity, once.segments[0].velocity)
    assert "4000 repeated stamps" in str(prepared)


def test_samples_about_missing_rows_do_not_count(recording: tuple[np.ndarray, ...]) -> None:
    time, position, torque, _ = recording
    whole = prepare(time, position, torque, PreprocessChoices(position_cutoff=10.0)).segments[0]

    def left_out(missing: np.ndarray) -> np.ndarray:
        kept = np.setdiff1d(np.arange(len(time)), missing)
        (segment,) = prepare(time[kept], position[kept], torque[kept], PreprocessChoices(position_cutoff=10.0)).segments
        return np.asarray(segment.time[~segment.used & whole.used[: len(segment.used)]])

    holes = np.array([1000, 1001, 1002, 2500, 2501, 2502])
    assert all(np.abs(time[holes] - moment).min() < 0.11 for moment in left_out(holes))
    assert len(left_out(holes)) == pytest.approx(2 * 0.22 * 200, rel=0.1)
    assert len(left_out(np.flatnonzero(np.arange(len(time)) % 20 < 3)[3:-3])) == 0  # too many to leave out


def test_window(recording: tuple[np.ndarray, ...]) -> None:
    time, position, torque, _ = recording
    prepared = prepare(time, position, torque, PreprocessChoices(start=5, stop=10))
    (segment,) = prepared.segments
    left_out = (1000 - len(segment.time)) / 200 / 2  # at each end
    assert 0 < left_out < 0.5
    assert segment.time[0] == pytest.approx(105 + left_out)
    assert prepared.steps[0].name == "window"
    assert prepared.steps[0].settings["samples"] == 1000


def test_positions_keep_their_offset_under_chebyshev_decimation(recording: tuple[np.ndarray, ...]) -> None:
    time, position, torque, _ = recording
    (segment,) = prepare(time, position + 2, torque, PreprocessChoices(position_decimate=5)).segments
    assert segment.rate == pytest.approx(40)
    assert np.diff(segment.time) == pytest.approx(0.025)
    assert np.abs(segment.position - 2 - fourier(segment.time)[0].T).max() < 2e-3
    assert segment.torque.shape == segment.position.shape


OPTIONS: dict[str, tuple[object, ...]] = {
    "position_cutoff": (None, 12.0),
    "torque_cutoff": (None, 5.0),
    "decimate": (None, 1, 3),
    "position_decimate": (1, 4),
    "filter": ("butterworth", "chebyshev"),
    "delay": (0.0, 0.003),
    "measured_velocity": (False, True),
    "keep_rest": (False, True),
}


def test_every_combination_of_options_runs(recording: tuple[np.ndarray, ...]) -> None:
    time, position, torque, velocity = (values[:1200] for values in recording)
    for values in itertools.product(*OPTIONS.values()):
        chosen = dict(zip(OPTIONS, values, strict=True))
        if chosen["filter"] == "chebyshev" and chosen["torque_cutoff"] and chosen["decimate"]:
            with pytest.raises(UsageError, match="one of the two"):
                PreprocessChoices(**chosen)  # type: ignore[arg-type]
            continue
        prepared = prepare(time, position, torque, PreprocessChoices(**chosen), velocity)  # type: ignore[arg-type]
        check_consistent(prepared)
        if chosen["decimate"]:
            assert prepared.parallel_filter.factor == chosen["decimate"]


def check_consistent(prepared: Prepared) -> None:
    for segment in prepared.segments:
        samples = len(segment.time)
        assert segment.used.shape == (samples,)
        for name in ("position", "velocity", "acceleration", "torque"):
            values = getattr(segment, name)
            assert values.shape == (3, samples)
            assert values.flags.c_contiguous
            assert np.isfinite(values).all()
        assert np.diff(segment.time).max() == pytest.approx(1 / segment.rate, rel=1e-4)
        filtered = prepared.parallel_filter.apply(segment.torque)
        assert filtered.shape[1] == len(segment.used[:: prepared.parallel_filter.factor])
    text = str(prepared)
    assert text.count("\n") == len(prepared.steps) - 1
    for step in prepared.steps:
        assert step.name in text
        assert all(isinstance(value, float | int | str) for value in step.settings.values())
    assert prepared.steps[-1].settings["factor"] == prepared.parallel_filter.factor


@each(
    ("field", "value"),
    [
        ("position_cutoff", 0.0),
        ("position_cutoff", -3.0),
        ("position_cutoff", float("nan")),
        ("torque_cutoff", 0.0),
        ("torque_cutoff", float("inf")),
        ("decimate", 0),
        ("position_decimate", 0),
        ("filter", "bessel"),
        ("delay", float("nan")),
        ("rest_velocity", -1.0),
        ("start", -1.0),
        ("stop", 0.0),
    ],
)
def test_choices_that_no_recording_could_fulfil(field: str, value: object) -> None:
    with pytest.raises(UsageError):
        replace(PreprocessChoices(), **{field: value})  # type: ignore[arg-type]


@each(
    "choices",
    [
        PreprocessChoices(position_cutoff=100.0),
        PreprocessChoices(torque_cutoff=150.0),
        PreprocessChoices(torque_cutoff=30.0, decimate=10),
        PreprocessChoices(position_decimate=100),
        PreprocessChoices(position_decimate=4, position_cutoff=30.0),
        PreprocessChoices(start=19.99),
        PreprocessChoices(start=1000.0),
        PreprocessChoices(delay=30.0),
        PreprocessChoices(delay=-19.99),
    ],
)
def test_choices_that_this_recording_cannot_fulfil(
    choices: PreprocessChoices, recording: tuple[np.ndarray, ...]
) -> None:
    time, position, torque, _ = recording
    with pytest.raises(UsageError) as error:
        prepare(time, position, torque, choices)
    assert error.value.hint or error.value.where


@pytest.mark.parametrize(
    "choices",
    [
        PreprocessChoices(),
        PreprocessChoices(position_decimate=3, delay=0.004, start=1.0, stop=19.0),
        PreprocessChoices(differentiation="savitzky-golay"),
    ],
)
def test_targets_are_filtered_like_positions(recording: tuple[np.ndarray, ...], choices: PreprocessChoices) -> None:
    """Targets that are the positions come out as the motion, in every segment and at every rate."""
    keep = np.ones(len(recording[0]), dtype=bool)
    keep[1500:1700] = False
    time, position, torque = (values[keep] for values in recording[:3])
    signals = JointSignals("", JOINTS[:3], time, position, torque, "given", target=position)
    prepared = prepare_signals(signals, choices)
    assert len(prepared.segments) == 2
    for segment in prepared.segments:
        assert segment.target is not None
        for quantity in ("position", "velocity", "acceleration"):
            np.testing.assert_allclose(getattr(segment.target, quantity), getattr(segment, quantity), atol=1e-6)
    hole = position.copy()
    hole[-1000, 0] = np.nan
    parts = prepare_signals(replace(signals, target=hole), choices).segments
    assert [segment.target is None for segment in parts] == [False, True]


def test_an_empty_window_is_refused() -> None:
    with pytest.raises(UsageError, match="empty"):
        PreprocessChoices(start=3.0, stop=2.0)


def test_bad_data_is_named(recording: tuple[np.ndarray, ...]) -> None:
    time, position, torque, _ = recording
    spoilt = torque.copy()
    spoilt[17, 1] = np.nan
    with pytest.raises(DataError, match="at sample 17") as error:
        prepare(time, position, spoilt, PreprocessChoices())
    assert error.value.where == "torque of elbow"
    for bad_time in (time[::-1], np.zeros(4000)):
        with pytest.raises(InputError):
            prepare(bad_time, position, torque, PreprocessChoices())
    for count in (0, 1, 15):
        with pytest.raises(DataError):
            prepare(time[:count], position[:count], torque[:count], PreprocessChoices())
    with pytest.raises(ValueError, match="shape"):
        prepare(time, position, torque[:, :2], PreprocessChoices())


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("name", "regular", "rate", "position", "torque"),
    [
        ("ur10_unisa1", True, 125, (4, 20), (2, 10)),
        ("panda_gaz1", False, 1000, (4, 20), (2, 10)),
        ("tx40_t1", True, 5000, (20, 60), (10, 30)),
    ],
)
def test_real_recordings(
    data_dir: Path, name: str, regular: bool, rate: float, position: tuple[float, ...], torque: tuple[float, ...]
) -> None:
    data = np.load(data_dir / f"{name}.npz")
    prepared = prepare(data["t"], data["q"], data["torque"], PreprocessChoices(), data.get("qd"))
    settings = {key: value for step in prepared.steps for key, value in step.settings.items()}
    (segment,) = prepared.segments
    assert prepared.irregularity.regular == regular
    assert segment.rate == pytest.approx(rate, rel=1e-6)
    assert position[0] < float(settings["position_cutoff_hz"]) < position[1]
    assert torque[0] < float(settings["torque_cutoff_hz"]) < torque[1]
    if name == "tx40_t1":  # stands still after 7.45 s
        assert not segment.used[segment.time > 7.6].any()
        assert inside(segment)[: int(6 * segment.rate)].all()
    else:
        assert inside(segment).all()
    if name == "panda_gaz1":  # 0.7 to 8.8 ms apart
        assert prepared.irregularity.shortest == pytest.approx(0.7e-3, rel=0.01)
        assert prepared.irregularity.longest == pytest.approx(8.8e-3, rel=0.01)
        assert segment.time.shape[0] == pytest.approx(21000, rel=0.05)
