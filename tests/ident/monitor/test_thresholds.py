"""Thresholds: rates of extreme values, ways of motion, smallest forces, the tool's wrench, the load, labels and ROC."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from monitored_arm import exact_samples, known_model

from daq.recording.recording import Channel, Recording, Stream
from drivers.core.errors import DataError, UsageError
from drivers.streams import Batch, ChannelLayout, StreamLayout
from ident.model.dynamic_model import build_model
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.dynamics.link_jacobian import LinkJacobians
from ident.model.load import load_effect
from ident.model.true_parameters import truth_vector
from ident.monitor.contact_forces import force_noticed, tool_wrench
from ident.monitor.extremes import require_time, return_level
from ident.monitor.interval_torque import JointSamples, rows_of
from ident.monitor.labelled_contacts import LabelledContact, found_at, operating_point, read_contacts, roc
from ident.monitor.live import LiveMonitor
from ident.monitor.load_estimate import LoadEstimator, changed_load
from ident.monitor.monitor import Monitor, dry_friction, earned_thresholds, joint_samples
from ident.monitor.thresholds import MotionWays, Thresholds
from ident.tasks.monitoring import at_rate
from sim_drivers.plant.altered_arm import with_load
from sim_drivers.synthetic.measurement import random_fourier_motion

THRESHOLDS = Thresholds(
    kind="direct",
    bandwidth=50.0,
    period=0.002,
    ways=MotionWays(np.zeros(6), np.zeros(6), 1),
    spread=np.ones((3, 6)),
    level=np.ones(3),
    tails={},
    per_hour=1.0,
    model_std=np.zeros(6),
    fastest=np.ones(6),
    celsius=None,
    drift=np.zeros(6),
    noticed=np.ones((3, 6)),
    momentum_noise=np.zeros(6),
    torque_noise=np.ones(6),
    torque_limit=np.ones(6),
    sources=(),
)
BLOCK = 0.2
"""[s]"""


def test_a_level_is_passed_as_often_as_asked_for() -> None:
    """Mean of the true rates over sets of exponential data."""
    rates = []
    for seed in range(12):
        maxima = np.random.default_rng(seed).exponential(size=300)
        found = return_level(maxima, 300 * BLOCK / 3600.0, 1.0)
        rates.append(np.exp(-found.level) * 3600.0 / BLOCK)
        assert found.interval[0] < found.level < 1.2 * found.interval[1]
    assert 0.2 < np.mean(rates) < 2.5


def test_data_that_are_too_short_are_refused_with_what_is_needed() -> None:
    with pytest.raises(DataError, match="at least 16 s"):
        require_time(5.0, 0.2, 100.0)
    with pytest.raises(DataError, match=r"at least 1.8e\+03 s"):
        require_time(100.0, 0.2, 1e-3)


def test_a_joint_is_near_rest_for_a_while_after_it_was() -> None:
    ways = MotionWays(np.array([0.1]), np.array([1.0]), hold=3)
    velocity = np.array([0.05, 0.5, 0.5, 0.5, 0.5, 2.0])[:, None]
    way, since = ways.of(velocity, np.array([np.inf]))
    assert way[:, 0].tolist() == [0, 0, 0, 0, 1, 2]
    assert since.tolist() == [5.0]
    stepped, state = [], np.array([np.inf])
    for row in velocity:
        one, state = ways.of(row[None], state)
        stepped.append(int(one[0, 0]))
    assert stepped == way[:, 0].tolist()


def test_what_was_not_learnt_is_named() -> None:
    names, still, warm = ("a", "b", "c", "d", "e", "f"), np.zeros((2, 6)), np.full((2, 6), 30.0)
    learnt = replace(THRESHOLDS, celsius=np.array([[20.0] * 6, [28.0] * 6]))
    assert learnt.beyond(names, still, warm) == ()
    assert "b is faster (2) than" in learnt.beyond(names, still + [0, 2.0, 0, 0, 0, 0], None)[0]
    assert "c is 8 K outside" in learnt.beyond(names, still, warm + [0, 0, 6.0, 0, 0, 0])[0]
    assert "d is 6 K outside" in learnt.beyond(names, still, warm - [0, 0, 0, 16.0, 0, 0])[0]


def test_thresholds_grow_with_the_distance_from_known_temperatures() -> None:
    learnt = replace(THRESHOLDS, celsius=np.array([[20.0] * 6, [28.0] * 6]), drift=np.arange(6.0))
    way, spread = np.zeros((4, 6), dtype=np.intp), np.ones((4, 6))
    heat = np.array([24.0, 30.0, 15.0, np.nan])[:, None] + np.zeros(6)
    added = np.outer([0.0, 2.0, 5.0, 0.0], np.arange(6.0))
    assert learnt.of(way, spread, heat) == pytest.approx(1.0 + added)
    assert np.all(learnt.of(way, spread, None) == 1.0)
    assert np.all(THRESHOLDS.of(way, spread, heat) == 1.0)
    warm = np.full((1, 6), 24.0) + 10.0 * (np.arange(6) == 2)
    assert "c is 6 K outside the temperatures at which thresholds were learnt: its threshold is 12 higher" in (
        learnt.beyond(tuple("abcdef"), spread, warm)
    )


def test_forces_and_wrenches() -> None:
    lever = np.array([[0.5, 0.0], [0.001, 0.0], [0.1, 1.0]])
    assert force_noticed(lever, np.array([10.0, 5.0])).tolist() == [20.0, np.inf, 5.0]
    model, _ = known_model("ur5e")
    places = LinkJacobians(model.dynamics.model)
    places.move(np.array([0.3, -1.2, 1.4, -0.6, 0.8, 0.2]))
    jacobian = places.jacobian(5, np.zeros(3))
    force = np.array([1.0, -2.0, 3.0, 0.1, 0.2, -0.3])
    wrench = tool_wrench(jacobian, jacobian.T @ force, np.full(6, 0.5))
    assert wrench is not None
    assert np.r_[wrench.force, wrench.moment] == pytest.approx(force)
    draws = np.random.default_rng(1).normal(scale=0.5, size=(4000, 6))
    spread = np.cov(
        np.array([np.r_[w.force, w.moment] for d in draws[:400] if (w := tool_wrench(jacobian, d, np.full(6, 0.5)))]).T
    )
    assert np.diag(spread) == pytest.approx(np.diag(wrench.covariance), rel=0.3)
    places.move(np.array([0.3, -1.2, 0.0, -0.6, 0.8, 0.2]))  # the stretched elbow
    assert tool_wrench(places.jacobian(5, np.zeros(3)), np.ones(6), np.ones(6)) is None
    assert tool_wrench(jacobian[:, :4], np.ones(4), np.ones(4)) is None


@pytest.fixture(scope="module")
def noisy() -> tuple[JointSamples, Thresholds]:
    """Four seconds of an exact motion ten times, with noise; and thresholds from them."""
    model, _ = known_model("ur5e")
    exact = exact_samples("ur5e", 2500)
    noise = np.random.default_rng(1).normal(scale=0.3, size=(4, *exact.torque.shape))
    runs = [(str(k), JointSamples(exact.time, exact.position, exact.torque + one)) for k, one in enumerate(noise)]
    return runs[0][1], earned_thresholds(model, runs)


def test_no_alarm_without_contact_and_one_for_a_push(noisy: tuple[JointSamples, Thresholds]) -> None:
    model, _ = known_model("ur5e")
    quiet, thresholds = noisy
    watched = Monitor(model, thresholds)
    watched.add(quiet)
    assert watched.contacts == []
    torque = quiet.torque.copy()
    torque[1000:1200, 2] -= 3.0 * thresholds.limit[:, 2].max()
    pushed = Monitor(model, thresholds)
    pushed.add(JointSamples(quiet.time, quiet.position, torque))
    (contact,) = pushed.contacts
    assert contact.joint == "elbow_joint"
    assert 0.0 < contact.time - quiet.time[1000] < 0.03
    assert contact.end - quiet.time[1200] < 0.05
    assert contact.torque > contact.threshold > 0.0


@pytest.mark.parametrize("together", [1500, 5])
def test_what_friction_may_hold_after_a_contact_at_rest_is_no_contact(
    noisy: tuple[JointSamples, Thresholds], together: int
) -> None:
    """The joint may lean against its friction since then, until it moves again; a further push is a contact."""
    model, _ = known_model("ur5e")
    quiet, thresholds = noisy
    count, dry = 1500, dry_friction(model)
    position = np.tile(quiet.position[0], (count, 1))
    torque = np.tile(model.torque(quiet.position[0]), (count, 1))
    torque[300:600, 1] += 3.0 * thresholds.limit[:, 1].max() + 2.0 * dry[1]
    torque[600:, 1] += 0.9 * dry[1]
    torque[1200:, 2] -= 2.0 * thresholds.limit[:, 2].max() + 2.0 * dry[2]
    assert 0.9 * dry[1] > thresholds.limit[0, 1]
    watched = Monitor(model, thresholds, load=False)
    time = 0.002 * np.arange(count)
    for begin in range(0, count, together):
        rows = slice(begin, begin + together)
        watched.add(JointSamples(time[rows], position[rows], torque[rows]))
    first, second = watched.contacts
    assert (first.joint, second.joint) == ("shoulder_lift_joint", "elbow_joint")
    assert time[600] < first.end < time[680]
    assert time[1200] < second.time < time[1220]


def test_the_torque_that_is_noticed_is_so_in_95_percent_of_the_cases(noisy: tuple[JointSamples, Thresholds]) -> None:
    model, _ = known_model("ur5e")
    quiet, thresholds = noisy
    assert np.any(thresholds.noticed < thresholds.limit)  # within 0.2 s, noise helps
    residuals = Monitor(model, thresholds, load=False).add(quiet)
    joints = np.arange(6)
    found = []
    for start in range(100, len(residuals.external) - 100, 50):
        at = slice(start + 30, start + 100)  # what is left of a contact of 0.2 s once the observer has settled
        torque = residuals.external[at] + thresholds.noticed[residuals.way[start], joints]
        found.append(np.any(torque > residuals.threshold[at], axis=0))
    assert 0.9 < np.mean(found) <= 1.0


@pytest.mark.parametrize("robot", ["ur5e", "sr400"])
def test_the_columns_of_a_load_are_those_of_the_model(robot: str) -> None:
    model, file = known_model(robot)
    thresholds = replace(THRESHOLDS, spread=np.ones((3, model.dof)))
    motion = np.random.default_rng(1).uniform(-0.5, 0.5, size=(3, model.dof))
    motion[0] += [np.mean(joint.position) for joint in file.robot.joints]
    effect = load_effect(model.dynamics.model, model.dynamics.base, file.robot)
    assert LoadEstimator(model, thresholds).columns(*motion) == pytest.approx(
        model.regressor(*motion) @ effect, abs=1e-9
    )


def test_a_load_is_estimated_with_its_interval(noisy: tuple[JointSamples, Thresholds]) -> None:
    model, file = known_model("ur5e")
    quiet, thresholds = noisy
    loaded = with_load(file, 2.0, (0.02, 0.0, 0.1), [0.0] * 6)
    arm = build_model(loaded)
    base = model.dynamics.base
    standard = truth_vector(loaded)
    dynamics = InverseDynamics(arm, base, base.projection @ standard, standard)
    motion = random_fourier_motion(build_model(file), 5.0, seed=1, candidates=1)
    torque = dynamics.torque(*motion.evaluate(quiet.time)).T
    torque += np.random.default_rng(2).normal(scale=0.3, size=torque.shape)
    torque[:800] = quiet.torque[:800]  # before it was picked up
    watched = Monitor(model, thresholds)
    residuals = watched.add(JointSamples(quiet.time, quiet.position, torque))
    assert len(watched.contacts) == 1
    load = watched.load
    whole, parts = (LoadEstimator(model, thresholds) for _ in range(2))
    whole.add(residuals.intervals, residuals.way)
    for begin in range(0, len(residuals.way), 7):
        parts.add(rows_of(residuals.intervals, slice(begin, begin + 7)), residuals.way[begin : begin + 7])
    assert whole.estimate is not None
    assert parts.estimate is not None
    assert parts.estimate.mass == pytest.approx(whole.estimate.mass)
    assert parts.estimate.seconds == whole.estimate.seconds
    assert load is not None
    assert abs(load.mass - 2.0) < max(2.0 * load.margin, 0.04)
    assert load.centre == pytest.approx([0.02, 0.0, 0.1], abs=0.02)
    assert "fits a load of 2.0" in changed_load(load)
    assert "fits the lack of a load of 2.0" in changed_load(replace(load, mass=-load.mass))
    assert (
        changed_load(replace(load, margin=1.0)) == changed_load(replace(load, seconds=1.0)) == changed_load(None) == ""
    )


def test_live_batches_give_contacts_a_reason_to_stop_and_lines(noisy: tuple[JointSamples, Thresholds]) -> None:
    model, file = known_model("ur5e")
    quiet, thresholds = noisy
    torque = quiet.torque.copy()
    torque[1000:1200, 2] -= 3.0 * thresholds.limit[:, 2].max()
    torque[1500] = np.nan
    gains = np.array([drive.gain for drive in file.robot.drives], dtype=float)
    names = model.joint_names
    channels = (
        *(ChannelLayout("current", names[::-1]), ChannelLayout("position", names)),
        ChannelLayout("statusword", names, "1"),
    )
    layout = StreamLayout("joints", channels, 500.0)
    watch = LiveMonitor(model, thresholds, stops=True)
    watch.begin([layout])
    reasons, events = [], []
    for start in range(0, 90, 3):  # the brakes hold the arm
        time, off = quiet.time[start : start + 3] - 1.0, np.zeros((3, 6))
        held = {"current": off, "position": off + quiet.position[0], "statusword": off + 0x250}
        watch.add(Batch("joints", time, time, held))
    assert watch.lines() == ("no external torque: a motor is off",)
    for start in range(0, 2400, 3):
        at = slice(start, start + 3)
        values = {"current": (torque[at] / gains)[:, ::-1], "position": quiet.position[at]}
        values["statusword"] = np.full((len(quiet.time[at]), 6), 0x1237)
        watch.add(Batch("joints", quiet.time[at], quiet.time[at], values))
        events += watch.events()
        reasons.append(watch.stop_reason())
    assert watch.failure == ""
    whole = Monitor(model, thresholds)
    whole.add(JointSamples(quiet.time[:2400], quiet.position[:2400], torque[:2400]))
    assert [time for time, _ in events] == [contact.time for contact in whole.contacts] == [whole.contacts[0].time]
    assert "elbow_joint" in next(filter(None, reasons))
    assert reasons[0] == reasons[-1] == ""
    said = "\n".join(watch.lines())
    assert "1 contact; no safety function" in said
    other_rate = replace(layout, rate=125.0)
    with pytest.raises(UsageError, match="125 Hz"):
        LiveMonitor(model, thresholds).begin([other_rate])
    with pytest.raises(UsageError, match="neither torque nor current"):
        LiveMonitor(model, thresholds).begin([replace(layout, channels=layout.channels[1:])])
    watch.add(Batch("joints", quiet.time[:5], quiet.time[:5], {"position": quiet.position[:5]}))
    assert "no longer monitored" in watch.stop_reason()


def test_recordings_at_another_rate_are_not_learnt_from(noisy: tuple[JointSamples, Thresholds]) -> None:
    quiet, _ = noisy
    slow = JointSamples(quiet.time[::4], quiet.position[::4], quiet.torque[::4])
    both = [("slow", slow), ("quick", quiet)]
    assert [name for name, _ in at_rate(both, 0.002)] == ["quick"]
    assert [name for name, _ in at_rate(both, 0.0081)] == ["slow"]
    with pytest.raises(DataError, match=r"has 250 Hz, unlike those without contact \(slow: 125 Hz\)"):
        at_rate(both, 0.004)


def test_a_recording_whose_time_goes_backwards_is_refused() -> None:
    model, file = known_model("ur5e")
    samples, names = exact_samples("ur5e"), model.joint_names
    time = np.where(np.arange(len(samples.time)) < 300, samples.time, samples.time - 5.0)
    rows = {"position": samples.position, "torque": samples.torque}
    channels = {name: Channel(name, values, "", names) for name, values in rows.items()}
    with pytest.raises(DataError, match="time goes backwards") as refused:
        joint_samples(model, Recording(file.text, {"joints": Stream("joints", time, time, channels)}))
    assert refused.value.where.endswith("sample 300")


def test_labels_and_operating_points(tmp_path: Path) -> None:
    file = tmp_path / "labels.csv"
    file.write_text("start,end,link\n1,2,elbow\n5,6,tool\n")
    contacts = read_contacts(file, 100.0)
    assert contacts == (LabelledContact(101.0, 102.0), LabelledContact(105.0, 106.0))
    time = 100.0 + 0.01 * np.arange(1000)
    ratio = np.full(1000, 0.5)
    ratio[120:150] = 2.0  # found after 0.2 s
    ratio[800:805] = 1.5  # a false alarm
    point = operating_point(time, ratio, contacts, 1.0, 0.01)
    assert (point.found, point.false_per_hour) == (0.5, pytest.approx(100.0))
    assert point.delay == pytest.approx(0.2)
    curve = roc(time, ratio, contacts, 0.01)
    assert found_at(curve, 0.0).found == 0.5
    assert found_at(curve, 0.0).threshold >= 1.5
    for text in ("a,b\n1,2\n", "start,end\n2,1\n", "start,end\nx,1\n", "start,end\n"):
        file.write_text(text)
        with pytest.raises(UsageError):
            read_contacts(file, 0.0)
