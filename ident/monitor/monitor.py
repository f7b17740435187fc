"""The observer at work: residuals, alarms, load and wrench of an arm, from batches of samples as they come."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq.recording.recording import Recording
from drivers.core.arrays import BoolArray, FloatArray, IndexArray
from drivers.core.errors import DataError
from drivers.core.units import ZERO_CELSIUS
from ident.model.another_arm import check_arm
from ident.model.dynamics.link_jacobian import LinkJacobians
from ident.monitor.choices import BANDWIDTH, Kind
from ident.monitor.contact_forces import Wrench, tool_wrench
from ident.monitor.interval_torque import Intervals, IntervalTorque, JointSamples, rows_of
from ident.monitor.load_estimate import LoadEstimator, ToolLoad
from ident.monitor.thresholds import REST, SETTLING, STD_EVERY, Thresholds, learn
from ident.result.graded import robots_of
from ident.result.models.model import Model
from ident.signals.joint_signals import read_joint_signals
from ident.signals.resampling import check_stamps, measure_irregularity

CREEPING = 1e-3
"""[rad/s or m/s] at which friction is dry alone."""
RELEASE = 0.7
"""Share of the threshold below which an alarm ends."""
RELEASE_TIME = 0.1
"""[s] for which every joint must have been below it."""
INERTIA_POSES = 20
"""Random poses over which the joints' inertias are averaged."""


@dataclass(frozen=True)
class Contact:
    """A contact that was noticed."""

    time: float  # of the sample that passed its threshold [s, the source's clock]
    end: float  # of the last that did [s]; nan while it lasts
    joint: str  # that passed it farthest
    torque: float  # largest external torque of this joint [N·m or N]
    threshold: float  # at that moment [N·m or N]
    ratio: float  # largest of torque over threshold
    unit: str  # of torque and threshold


@dataclass(frozen=True)
class WatchedBatch:
    """What a batch of samples gave; N of n joints."""

    intervals: Intervals  # motion, measured torque and unfiltered external torque
    external: FloatArray  # (N, n) external torque [N·m or N]
    threshold: FloatArray  # (N, n) beyond which |external| is an alarm [N·m or N]
    spread: FloatArray  # (N, n) its σ without contact [N·m or N]
    way: IndexArray  # (N, n) of motion
    alarm: BoolArray  # (N,) whether an alarm is on

    @property
    def ratio(self) -> FloatArray:
        """(N,) the largest |external| over its threshold."""
        if not len(self.external):
            return np.zeros(0)
        return np.asarray(np.max(np.abs(self.external) / self.threshold, axis=1))


class Monitor:
    """Watches an arm; batches may be divided in any way, the result is the same.

    Args:
        model: of the whole arm.
        thresholds: of its residual.
        load: whether a load is estimated, too.

    Attributes:
        contacts: noticed so far, in order of time; the last one may last.
        lag: time [s] after a sample at which its residual is known.
    """

    def __init__(self, model: Model, thresholds: Thresholds, *, load: bool = True) -> None:
        self.model, self.thresholds = model, thresholds
        self._intervals = IntervalTorque(model, thresholds.period, momentum=thresholds.kind != "direct")
        self._observer = thresholds.observer()
        self._load = LoadEstimator(model, thresholds) if load else None
        self._places = LinkJacobians(model.dynamics.model)
        self._tool = np.array(model.stored.robot_file.robot.workspace.tool)
        self._units = [joint.unit("N·m") for joint in model.stored.robot_file.robot.joints]
        self._since = np.full(model.dof, np.inf)
        self._std, self._count = np.zeros(model.dof), 0
        self._settle = round(SETTLING / (thresholds.bandwidth * thresholds.period))
        self._after_restart = 0
        self._below = 0.0
        self._last: WatchedBatch | None = None
        self._dry = dry_friction(model, None if thresholds.celsius is None else thresholds.celsius.mean(axis=0))
        self._hidden = np.zeros(model.dof, dtype=bool)  # since a contact at rest: friction may hold the joint by all
        self.contacts: list[Contact] = []
        self.lag = self._intervals.lag

    def add(self, samples: JointSamples) -> WatchedBatch:
        """Take over samples (N, n); what they complete.

        Raises:
            DataError: another number of joints, or a temperature is missing.
        """
        intervals = self._intervals.add(samples)
        external = self._observer.apply(intervals.external, intervals.restarted)
        way, self._since = self.thresholds.ways.of(intervals.velocity, self._since)
        spread = self.thresholds.spread_of(way, self._model_std(intervals))
        threshold = self.thresholds.of(way, spread, intervals.celsius)
        alarm = np.zeros(len(intervals), dtype=bool)
        resting = way == REST
        spare = self._held_by_friction(resting)
        ratio = (np.abs(external) - spare) / threshold
        lasting = bool(self.contacts) and np.isnan(self.contacts[-1].end)
        if not lasting and not np.any(ratio > 1.0) and not intervals.restarted.any():
            self._hidden &= resting.all(axis=0)
            self._after_restart += len(intervals)
            if self._load is not None:
                self._load.add(intervals, way)
        elif len(intervals):
            begun = 0
            for row, restarted in enumerate(intervals.restarted.tolist()):
                self._after_restart = 0 if restarted else self._after_restart + 1
                self._hidden &= resting[row]
                before = len(self.contacts)
                alarm[row] = self._judged(float(intervals.time[row]), external[row], threshold[row], ratio[row])
                if len(self.contacts) > before:
                    self._hidden, after = resting[row], slice(row + 1, None)
                    spare[after] = self._held_by_friction(resting[after])
                    ratio[after] = (np.abs(external[after]) - spare[after]) / threshold[after]
                if len(self.contacts) > before and self._load is not None:
                    self._load.add(rows_of(intervals, slice(begun, row)), way[begun:row])
                    self._load.restart()  # what was grasped is another load from now on
                    begun = row
            if self._load is not None:
                self._load.add(rows_of(intervals, slice(begun, None)), way[begun:])
        result = WatchedBatch(intervals, external, threshold + spare, spread, way, alarm)
        self._last = result if len(intervals) else self._last
        return result

    def _held_by_friction(self, resting: BoolArray) -> FloatArray:
        """(N, n) torque by which friction may hold joints that rest since a contact began, by `resting` (N, n)."""
        return np.asarray(self._dry * (np.logical_and.accumulate(resting, axis=0) & self._hidden))

    def _model_std(self, intervals: Intervals) -> FloatArray:
        """(N, n) σ of the model, which changes slowly: of every `STD_EVERY`-th sample, held in between."""
        count = len(intervals)
        due = np.arange(-self._count % STD_EVERY, count, STD_EVERY)
        self._count += count
        if not len(due):
            return self._std[None].repeat(count, axis=0)
        heat = None if intervals.celsius is None else intervals.celsius[due]
        rows = self.model.torque_std(intervals.position[due], intervals.velocity[due], None, heat)
        held = np.vstack([self._std, rows])
        self._std = held[-1]
        return np.asarray(held[np.searchsorted(due, np.arange(count), side="right")])

    def _judged(self, time: float, external: FloatArray, threshold: FloatArray, ratio: FloatArray) -> bool:
        """Return whether an alarm is on; contacts begin and end here."""
        largest = float(ratio.max())
        lasting = bool(self.contacts) and np.isnan(self.contacts[-1].end)
        if largest > 1.0 and self._after_restart >= self._settle:
            joint = int(ratio.argmax())
            now = Contact(
                time,
                np.nan,
                self.model.joint_names[joint],
                float(external[joint]),
                float(threshold[joint]),
                largest,
                self._units[joint],
            )
            if not lasting:
                self.contacts.append(now)
            elif largest > self.contacts[-1].ratio:
                self.contacts[-1] = replace(now, time=self.contacts[-1].time)
            self._below = time
            return True
        if not lasting:
            return False
        if largest > RELEASE:
            self._below = time
        elif time - self._below >= RELEASE_TIME:
            self.contacts[-1] = replace(self.contacts[-1], end=self._below)
            return False
        return True

    @property
    def load(self) -> ToolLoad | None:
        """The load since the last contact began; None before the arm has moved long enough."""
        return None if self._load is None else self._load.estimate

    @property
    def wrench(self) -> Wrench | None:
        """The wrench at the tool by the newest sample; None where joint torques do not determine it."""
        if self._last is None:
            return None
        self._places.move(self._last.intervals.position[-1])
        jacobian = self._places.jacobian(self.model.dynamics.model.tool_link, self._tool)
        return tool_wrench(jacobian, self._last.external[-1], self._last.spread[-1])


def joint_samples(model: Model, recording: Recording) -> JointSamples:
    """A recording's samples for a monitor of its model, torques by the drive gains of the model's robot file.

    Raises:
        DataError: it lacks positions, a torque, a joint or a gain, its time goes backwards, or it is of another arm.
    """
    check_arm([recording], model.stored.robot_file, robots_of(model.result.recordings))
    signals = read_joint_signals(recording, model.stored.robot_file.robot)
    try:
        check_stamps(signals.time)  # a contact at a time that comes twice could not be found again
    except DataError as error:
        raise DataError(error.message, where=f"{signals.label}: {error.where}", hint=error.hint) from error
    celsius = None if signals.temperature is None else signals.temperature - ZERO_CELSIUS
    return JointSamples(signals.time, signals.position, signals.torque @ model.coupling, celsius)


def sample_period(samples: JointSamples) -> float:
    """The nominal period [s] of samples."""
    return measure_irregularity(samples.time).median_period


def dry_friction(model: Model, celsius: FloatArray | None = None) -> FloatArray:
    """Friction (n,) that may hold a resting joint [N·m or N], at temperatures (n,) [°C]; 0 where these are unknown."""
    still = np.zeros(model.dof)
    if celsius is None and model.dynamics.model.needs_temperature:
        return still
    creeping = np.array([CREEPING, -CREEPING])[:, None] + still
    heat = None if celsius is None or not model.dynamics.model.needs_temperature else np.array([celsius, celsius])
    one, other = model.friction(creeping, np.zeros_like(creeping), heat)
    return np.asarray(np.abs(one - other) / 2.0)


def earned_thresholds(
    model: Model,
    quiet: Sequence[tuple[str, JointSamples]],
    *,
    kind: Kind = "momentum",
    bandwidth: float | None = None,
    per_hour: float = 1.0,
    period: float | None = None,
) -> Thresholds:
    """Thresholds that recordings without contact give for so many false alarms per hour.

    The observer's bandwidth K is in 1/s, its default where None. The samples that will be watched have this period [s];
    the first recording's where None.

    Raises:
        DataError: the recordings are too short for this rate.
        ModelError: the model has parameters without a value.
        ResultFileError: the result holds no covariance.
    """
    own = period or (sample_period(quiet[0][1]) if quiet else 0.0)
    runs, stds = [], []
    for name, samples in quiet:
        intervals = IntervalTorque(model, sample_period(samples), momentum=kind != "direct").add(samples)
        runs.append((name, intervals))
        at = slice(None, None, STD_EVERY)
        heat = None if intervals.celsius is None else intervals.celsius[at]
        if len(intervals):
            stds.append(model.torque_std(intervals.position[at], intervals.velocity[at], None, heat))
    joints = model.stored.robot_file.robot.joints
    low, high = (np.array(bound) for bound in zip(*(joint.position for joint in joints), strict=True))
    poses = np.random.default_rng(0).uniform(np.maximum(low, -10.0), np.minimum(high, 10.0), (INERTIA_POSES, model.dof))
    return learn(
        runs,
        stds,
        np.array([joint.velocity for joint in joints]),
        kind=kind,
        bandwidth=bandwidth or BANDWIDTH[kind],
        period=own,
        per_hour=per_hour,
        inertia=np.mean(np.diagonal(model.mass_matrix(poses), axis1=1, axis2=2), axis=0),
        friction=_friction(model, [intervals for _, intervals in runs if len(intervals)]),
    )


def _friction(model: Model, runs: Sequence[Intervals]) -> FloatArray:
    """(n,) [N·m or N] of the joints at the fastest speeds of recordings; 0 where the model has temperature terms."""
    if not runs:
        return np.zeros(model.dof)
    fastest = np.max([np.abs(run.velocity).max(axis=0) for run in runs], axis=0)
    heat = None if runs[0].celsius is None else runs[0].celsius[:1].repeat(2, axis=0)
    forward, backward = model.friction(np.array([fastest, -fastest]), runs[0].position[:1].repeat(2, axis=0), heat)
    return np.where(model.dynamics.model.needs("temperature"), 0.0, 0.5 * np.abs(forward - backward))
