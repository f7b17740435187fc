"""Watch a recording with an identified model in one call: external torque, contacts, and what would be noticed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from daq.recording.reader import read_recording
from daq.recording.recording import Recording
from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError, UsageError
from drivers.core.files import path_of
from drivers.core.options import keywords_of
from drivers.core.text import counted
from drivers.core.units import common_unit
from ident.identify.revalidate import unchanged_files
from ident.monitor.contact_forces import SmallestForce, expected_delay, smallest_forces
from ident.monitor.interval_torque import JointSamples
from ident.monitor.labelled_contacts import (
    LabelledContact,
    OperatingPoint,
    found_at,
    operating_point,
    read_contacts,
    roc,
)
from ident.monitor.load_estimate import ToolLoad, changed_load
from ident.monitor.monitor import Contact, Monitor, WatchedBatch, earned_thresholds, joint_samples, sample_period
from ident.monitor.thresholds import SAME_RATE, Thresholds
from ident.report.monitor_page import monitor_page
from ident.result.models.model import Model
from ident.result.tables import Table, table_of_rows
from ident.tasks.arguments import PagedResult, recording_of, recordings_of
from ident.tasks.options import DetectionOptions, MonitorOptions
from ident.tasks.prediction import model_of

POSES = 40
"""Poses of the recordings without contact at which the smallest forces are stated."""


@dataclass(frozen=True)
class Detector:
    """A way to notice contacts, against labelled ones."""

    name: str  # of it
    points: tuple[OperatingPoint, ...]  # for every threshold
    chosen: OperatingPoint  # at the threshold that the data without contact gave


@dataclass(frozen=True, eq=False)
class MonitoredRun(PagedResult):
    """A recording under the eyes of a model; N samples of n joints, those near gaps left out.

    Example:
        >>> import dynid
        >>> run, other = (dynid.simulate("ur5e", duration=20.0, seed=seed) for seed in (1, 2))
        >>> watched = dynid.monitor(dynid.identify(run), other, quiet=run)
        >>> watched.external.shape == watched.threshold.shape, len(watched.contacts)
        (True, 0)
    """

    model: Model = field(repr=False)
    label: str  # what messages call the recording
    joint_names: tuple[str, ...]  # (n,)
    time: FloatArray  # (N,) the recording's clock [s]
    external: FloatArray  # (N, n) external torque that acts on the arm, through the observer [N·m or N]
    threshold: FloatArray  # (N, n) beyond which it is an alarm [N·m or N]
    std: FloatArray  # (N, n) its σ without contact [N·m or N]
    measured: FloatArray  # (N, n) torque of the drives [N·m or N]
    contacts: tuple[Contact, ...]  # that were noticed, in order of time
    smallest: tuple[SmallestForce, ...]  # forces on each link that are noticed
    delay: float  # expected until a force of twice that size is noticed [s]
    load: ToolLoad | None  # on the tool since the last contact began; None where the arm hardly moved since
    thresholds: Thresholds  # what contacts were judged by
    beyond: tuple[str, ...] = ()  # what of the motion the thresholds were not learnt on, in words
    detectors: tuple[Detector, ...] = ()  # against labelled contacts; empty where none were given

    @cached_property
    def summary(self) -> Table:
        """The contacts: when, which joint felt them most, and how much."""
        start = float(self.time[0])
        rows = [
            (contact.time - start, (contact.end if np.isfinite(contact.end) else float(self.time[-1])) - contact.time)
            + (contact.joint, contact.torque, contact.threshold, contact.ratio)
            for contact in self.contacts
        ]
        unit = common_unit("N·m", self.model.dynamics.model.sliding)
        headings = [
            ("time", "s"),
            ("duration", "s"),
            ("joint", ""),
            ("torque", unit),
            ("threshold", unit),
            ("ratio", ""),
        ]
        return table_of_rows(f"Contacts in {self.label}", headings, rows)

    @cached_property
    def sensitivity(self) -> Table:
        """The smallest force on each link's end that is noticed in 95 % of the moments [N], by axis of the base."""
        return sensitivity_table(self.smallest)

    @cached_property
    def comparison(self) -> Table | None:
        """Each detector against the labelled contacts; None where none were given."""
        if not self.detectors:
            return None
        rows = []
        for detector in self.detectors:
            silent = found_at(detector.points, 0.0)
            chosen = detector.chosen
            rows.append(
                (detector.name, 100.0 * chosen.found, chosen.false_per_hour, _number(1e3 * chosen.delay))
                + (100.0 * silent.found, _number(1e3 * silent.delay))
            )
        headings = [("detector", ""), ("found", "%"), ("false alarms", "1/h"), ("median delay", "ms")]
        headings += [("found without a false alarm", "%"), ("its median delay", "ms")]
        return table_of_rows("Against the labelled contacts", headings, rows)

    def _page(self) -> str:
        tables = [table for table in (self.summary, self.comparison, self.sensitivity) if table is not None]
        series = (self.time, self.external, self.threshold)
        return monitor_page(self.model.stored.robot_file.robot, self.label, tables, self.explanation, series)

    @property
    def explanation(self) -> list[str]:
        """Return where the thresholds come from, a sentence each."""
        said = [*explanation(self.thresholds, self.delay), *self.beyond]
        return [*said, carried] if self.contacts and (carried := changed_load(self.load)) else said

    def to_dict(self) -> dict[str, Any]:
        """Return what `dynid monitor --json` prints."""
        first = float(self.time[0])
        return {
            "recording": self.label,
            "samples": len(self.time),
            "observer": self.thresholds.kind,
            "bandwidth": self.thresholds.bandwidth,
            "false_alarms_per_hour": self.thresholds.per_hour,
            "contacts": [
                {**asdict(contact), "time": contact.time - first, "end": contact.end - first}
                for contact in self.contacts
            ],
            "thresholds": {
                "level": self.thresholds.level.tolist(),
                "spread": self.thresholds.spread.tolist(),
                "tails": {name: asdict(tail) for name, tail in self.thresholds.tails.items()},
                "sources": self.thresholds.sources,
            },
            "smallest_force": {
                force.link: {
                    "moving": force.moving.tolist(),
                    "worst": force.worst.tolist(),
                    "resting": force.resting.tolist(),
                }
                for force in self.smallest
            },
            "expected_delay": self.delay,
            "beyond": self.beyond,
            "load": None if self.load is None else {"mass": self.load.mass, "margin": self.load.margin},
            "detectors": {
                detector.name: {"chosen": asdict(detector.chosen), "roc": [asdict(point) for point in detector.points]}
                for detector in self.detectors
            },
        }

    def __repr__(self) -> str:
        contacts = counted(len(self.contacts), "contact")
        return f"<dynid.MonitoredRun of {self.label}: {len(self.time)} samples, {contacts}>"

    def _parts(self) -> tuple[object, ...]:
        return (self.summary,)


@keywords_of(MonitorOptions)
def monitor(options: MonitorOptions) -> MonitoredRun:
    """Watch a recording: the external torque on every joint, contacts, and the smallest force that is noticed.

    Raises:
        DataError: a recording lacks what is needed, is of another arm, or those without contact are too short.
        ModelError: the model is not that of the whole arm.
        ResultFileError: no result, or it holds no covariance.
        UsageError: the model's own recordings are gone and none was given, or the file of contacts is wrong.

    Example:
        >>> import dynid
        >>> run, other = (dynid.simulate("ur5e", duration=20.0, seed=seed) for seed in (1, 2))
        >>> dynid.monitor(dynid.identify(run), other, quiet=run, observer="kalman").sensitivity.columns[0].heading
        'link'
    """
    model = model_of(options.identified, None, "the external torque")
    recording = recording_of(options.run)
    samples = joint_samples(model, recording)
    thresholds, poses = learnt_thresholds(model, options, sample_period(samples), recording)
    watched = Monitor(model, thresholds)
    residuals = watched.add(samples)
    if not len(residuals.external):
        raise DataError("no samples follow each other without a gap", where=recording.label)
    labelled: tuple[LabelledContact, ...] = ()
    if options.contacts is not None:
        labelled = read_contacts(path_of(options.contacts), float(samples.time[0]))
    return MonitoredRun(
        model=model,
        label=recording.label,
        joint_names=model.joint_names,
        time=residuals.intervals.time,
        external=residuals.external,
        threshold=residuals.threshold,
        std=residuals.spread,
        measured=residuals.intervals.measured,
        contacts=tuple(watched.contacts),
        smallest=forces_noticed(model, thresholds, poses),
        delay=expected_delay(thresholds, watched.lag),
        load=watched.load,
        thresholds=thresholds,
        beyond=thresholds.beyond(model.joint_names, residuals.intervals.velocity, residuals.intervals.celsius),
        detectors=_detectors(residuals, thresholds, labelled),
    )


def learnt_thresholds(
    model: Model, options: DetectionOptions, period: float | None = None, watched: Recording | None = None
) -> tuple[Thresholds, FloatArray]:
    """Thresholds from the recordings without contact, and poses (K, n) of theirs.

    Args:
        model: of the whole arm.
        options: the observer, and the recordings without contact; those of the model where it names none.
        period: of the samples that are watched [s]; that of the recordings without contact where None.
        watched: recording that is watched, which is not learnt from unless it is named.

    Raises:
        UsageError: no recordings are named, and those of the model are gone.
        DataError: they are too short for the rate, or of another arm.
    """
    quiet = recordings_of(options.quiet) if options.quiet else own_recordings(model, watched)
    samples: list[tuple[str, JointSamples]] = [
        (recording.label, joint_samples(model, recording)) for recording in quiet
    ]
    samples = at_rate(samples, period or sample_period(samples[0][1]))
    thresholds = earned_thresholds(
        model, samples, kind=options.observer, bandwidth=options.bandwidth, per_hour=options.false_alarms, period=period
    )
    positions = np.concatenate([entry.position for _, entry in samples])
    return thresholds, positions[:: max(1, len(positions) // POSES)]


def at_rate(samples: list[tuple[str, JointSamples]], period: float) -> list[tuple[str, JointSamples]]:
    """Those recordings whose samples come as often as the watched ones: an observer leaves another residual otherwise.

    Raises:
        DataError: there are none.
    """
    alike = [(name, entry) for name, entry in samples if abs(sample_period(entry) / period - 1.0) < SAME_RATE]
    if not alike:
        name, other = samples[0]
        raise DataError(
            f"the recording has {1.0 / period:.4g} Hz, unlike those without contact ({name}: "
            f"{1.0 / sample_period(other):.4g} Hz)",
            hint="--quiet names a recording of ordinary motion at the same rate",
        )
    return alike


def own_recordings(model: Model, watched: Recording | None = None) -> list[Recording]:
    """The recordings that a model was identified and validated on, as far as they still are what they were.

    Raises:
        UsageError: there are none.
    """
    folders = [] if watched is None or watched.path is None else [watched.path.parent]
    recordings = [path for _, path in unchanged_files(model.result.recordings, folders)]
    own = None if watched is None or watched.path is None else watched.path.resolve()
    recordings = list(dict.fromkeys(path for path in recordings if path.resolve() != own))
    if not recordings:
        raise UsageError(
            "the recordings of the model were moved, or include the one to analyse",
            where=model.name,
            hint="--quiet names a recording of ordinary motion without contact",
        )
    return [read_recording(path) for path in recordings]


def forces_noticed(model: Model, thresholds: Thresholds, poses: FloatArray) -> tuple[SmallestForce, ...]:
    """The smallest forces on a model's links at poses (K, n)."""
    tool = np.array(model.stored.robot_file.robot.workspace.tool)
    return smallest_forces(model.dynamics.model, thresholds, tool, poses)


def sensitivity_table(smallest: Sequence[SmallestForce]) -> Table:
    """The smallest forces that are noticed, a row per link [N]."""
    rows = [
        (force.link, *(_number(value) for forces in (force.moving, force.worst, force.resting) for value in forces))
        for force in smallest
    ]
    names = [f"{axis}{way}" for way in ("", " worst pose", " near rest") for axis in "xyz"]
    title = "Smallest force detected, either direction"
    return table_of_rows(title, [("link", ""), *((name, "N") for name in names)], rows)


def explanation(learnt: Thresholds, delay: float) -> list[str]:
    """Sentences on the origin of thresholds, and on the expected delay [s] of a force of twice the smallest."""
    said = [
        f"{learnt.kind} observer, {learnt.bandwidth:g} 1/s; thresholds for {counted(learnt.per_hour, 'false alarm')} "
        f"per hour, from {3600.0 * max((tail.hours for tail in learnt.tails.values()), default=0.0):.0f} s without "
        f"contact: {', '.join(learnt.sources)}"
    ]
    for name, tail in learnt.tails.items():
        said.append(
            f"{name}: {tail.level:.3g} σ (90 % interval {tail.interval[0]:.3g} to {tail.interval[1]:.3g}), "
            f"extrapolated {tail.extrapolation:.3g} times beyond the time observed"
        )
    said.append(
        f"a force of twice the smallest is expected to be detected after {1e3 * delay:.0f} ms; this is no safety "
        "function"
    )
    return said


def _detectors(
    residuals: WatchedBatch, thresholds: Thresholds, labelled: Sequence[LabelledContact]
) -> tuple[Detector, ...]:
    """The earned thresholds, and what users do today: one constant per joint, on the residual and on the torque."""
    if not labelled:
        return ()
    time = residuals.intervals.time
    hours = (float(time[-1] - time[0]) - sum(contact.end - contact.start for contact in labelled)) / 3600.0
    if hours <= 0.0:
        raise UsageError("the labelled contacts leave no time without contact", where="--contacts")
    ways = {
        "external torque, learnt thresholds": residuals.ratio,
        "external torque, one threshold per joint": np.max(
            np.abs(residuals.external) / np.max(thresholds.limit, axis=0), axis=1
        ),
        "torque of the drives, one threshold per joint": np.max(
            np.abs(residuals.intervals.measured) / thresholds.torque_limit, axis=1
        ),
    }
    return tuple(
        Detector(name, roc(time, ratio, labelled, hours), operating_point(time, ratio, labelled, 1.0, hours))
        for name, ratio in ways.items()
    )


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
