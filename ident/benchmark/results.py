"""Figures of all entries: where dynid loses first, then the tables, as text, JSON and a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from drivers.core.text import json_text
from ident.benchmark.dataset import Dataset
from ident.benchmark.entry import DEFAULTS
from ident.benchmark.judge import ServoScore, TorqueScore
from ident.report.html_file import rendered
from ident.result.tables import Cell, Column, Table, table_of_rows
from ident.tasks.arguments import SavedResult

BENCHMARK_FILE = "benchmark.json"
"""Name of the figures in the folder that `save` writes."""


@dataclass(frozen=True)
class Entry:
    """One method on one data set."""

    # dataset, method: their names
    dataset: str
    method: str
    score: TorqueScore | ServoScore | None = None  # None where there is none
    # of two halves of the training data: how many have intervals, and how many of the differences' 95 % intervals have
    # zero in them; None where the method has none
    parameters: tuple[int, int] | None = None
    seconds: float = float("nan")  # CPU time of the training [s]
    memory: float = float("nan")  # largest of the process, with all that it imports and the judge [MB]
    failure: str = ""  # why there is no score; empty where there is one

    @property
    def error(self) -> float:
        """What entries of a data set are ordered by: relative error in the band [%], or roll-out error [mrad]."""
        if isinstance(self.score, TorqueScore):
            return self.score.relative_error
        return float("inf") if self.score is None else self.score.rollout_error


@dataclass(frozen=True)
class Skipped:
    """A data set that was not judged on, and why."""

    dataset: str
    reason: str


@dataclass(frozen=True)
class Benchmark(SavedResult):
    """All figures of one call."""

    FILE = BENCHMARK_FILE

    datasets: tuple[Dataset, ...]  # that were judged on
    entries: tuple[Entry, ...]  # by data set, in the order of the methods
    skipped: tuple[Skipped, ...]  # data sets whose files are missing
    versions: dict[str, str]  # of what ran

    def of(self, dataset: str) -> list[Entry]:
        """Entries with a score on a data set, the best first."""
        scored = [entry for entry in self.entries if entry.dataset == dataset and entry.score is not None]
        return sorted(scored, key=lambda entry: entry.error)

    @property
    def judges_ours(self) -> bool:
        """Return whether dynid's default is among the entries with a score."""
        return any(entry.method in DEFAULTS and entry.score is not None for entry in self.entries)

    @property
    def losses(self) -> Table:
        """Every figure in which another entry is better than dynid's default, by data set.

        The difference of errors is over blocks of held-out time, with its 95 % interval (Student's t).
        """
        headings = [
            ("data set", ""),
            ("measure", ""),
            ("dynid", ""),
            ("better", ""),
            ("entry", ""),
            ("significant", ""),
        ]
        rows: list[tuple[Cell, ...]] = []
        for dataset in self.datasets:
            ranked = self.of(dataset.name)
            ours = next((entry for entry in ranked if entry.method in DEFAULTS), None)
            if ours is not None:
                rows += [row for other in ranked for row in _lost(dataset, ours, other)]
        return table_of_rows("Where dynid loses", headings, rows)

    @property
    def tables(self) -> tuple[Table, ...]:
        """One of each data set, the best entry first."""
        return tuple(_table(dataset, self.of(dataset.name)) for dataset in self.datasets)

    @property
    def joint_tables(self) -> tuple[Table, ...]:
        """Errors of each joint, one of each data set."""
        return tuple(_joint_table(dataset, self.of(dataset.name)) for dataset in self.datasets)

    @property
    def failures(self) -> tuple[str, ...]:
        """Entries without a score and data sets without files, and why."""
        failed = [f"{entry.dataset}, {entry.method}: {entry.failure}" for entry in self.entries if entry.failure]
        return (*failed, *(f"{of.dataset} left out: {of.reason}" for of in self.skipped))

    def to_json(self) -> str:
        """Output of `dynid bench --json`."""
        datasets = [dataset.model_dump(by_alias=True) for dataset in self.datasets]
        figures = {"skipped": self.skipped, "versions": self.versions}
        return json_text({"losses": self.losses, "entries": self.entries, "datasets": datasets, **figures})

    def _page(self) -> str:
        return rendered("benchmark_page", benchmark=self)

    def _parts(self) -> tuple[object, ...]:
        return self.losses, *self.tables, "\n".join(self.failures)


def _difference(ours: Entry, other: Entry) -> tuple[float, float]:
    """Mean difference of the errors over blocks of held-out time, ours minus the other's, and half of its interval."""
    if ours.score is None or other.score is None:
        return float("nan"), float("inf")
    errors = []
    for score in (ours.score, other.score):
        sums, weights = (np.array(row) for row in score.blocks)
        ratio = np.divide(sums, weights, out=np.full_like(sums, np.nan), where=weights > 0)
        errors.append(100.0 * np.sqrt(ratio) if isinstance(score, TorqueScore) else ratio)
    if len(errors[0]) != len(errors[1]):
        return float("nan"), float("inf")
    differences = errors[0] - errors[1]
    differences = differences[np.isfinite(differences)]
    count = len(differences)
    if count < 2:
        return float(differences.mean()) if count else float("nan"), float("inf")
    half = float(student.ppf(0.975, count - 1) * differences.std(ddof=1) / np.sqrt(count))
    return float(differences.mean()), half


def _lost(dataset: Dataset, ours: Entry, other: Entry) -> list[tuple[Cell, ...]]:
    """Rows of the figures in which another entry is better; dynid's own further entries count as others."""
    if other is ours:
        return []
    mean, half = _difference(ours, other)
    significant = "yes" if abs(mean) > half else "no"
    rows: list[tuple[Cell, ...]] = []

    def compare(measure: str, mine: float | None, theirs: float | None, answer: str = "") -> None:
        if mine is not None and theirs is not None and theirs < mine:
            rows.append((dataset.name, measure, mine, theirs, other.method, answer))

    if isinstance(ours.score, TorqueScore) and isinstance(other.score, TorqueScore):
        compare("error in the band [%]", ours.score.relative_error, other.score.relative_error, significant)
        compare("error of raw samples [%]", ours.score.raw_relative_error, other.score.raw_relative_error)
        mine, theirs = (score.forward.ratio if score.forward else None for score in (ours.score, other.score))
        compare("simulation / constant velocity", mine, theirs)
        for of, against in zip(ours.score.joints, other.score.joints, strict=True):
            if against.band < 0.9 * of.band:
                compare(f"{of.joint} [N·m]", of.band, against.band)
    elif isinstance(ours.score, ServoScore) and isinstance(other.score, ServoScore):
        compare("roll-out error [mrad]", ours.score.rollout_error, other.score.rollout_error, significant)
        for name, value in ours.score.joints.items():
            compare(f"{name} [mrad]", value, other.score.joints.get(name))
    return rows


def _table(dataset: Dataset, entries: Sequence[Entry]) -> Table:
    if dataset.kind == "servo":
        headings: list[Column | tuple[str, str]] = [
            ("entry", ""),
            ("roll-out error", "mrad"),
            ("CPU time", "s"),
            ("memory", "MB"),
        ]
        return table_of_rows(
            dataset.title, headings, [(entry.method, entry.error, entry.seconds, entry.memory) for entry in entries]
        )
    headings = [
        ("entry", ""),
        ("band", "%"),
        ("raw", "%"),
        ("difference to the first", "%"),
        ("interval", "%"),
        ("simulation", "× constant velocity"),
        ("diverged", "%"),
        ("bodies", ""),
        ("inertia positive", "%"),
        ("parameters agree", ""),
        ("CPU time", "s"),
        ("memory", "MB"),
    ]
    return table_of_rows(dataset.title, headings, [_row(entry, entries[0]) for entry in entries])


def _row(entry: Entry, first: Entry) -> tuple[Cell, ...]:
    score = entry.score
    assert isinstance(score, TorqueScore)
    mean, half = _difference(entry, first)
    same = entry is first
    return (
        entry.method,
        score.relative_error,
        score.raw_relative_error,
        None if same else mean,
        None if same or not np.isfinite(half) else half,
        score.forward.ratio if score.forward else None,
        100.0 * score.forward.diverged if score.forward else None,
        f"{score.consistent_links} of {score.links}" if score.links else None,
        score.positive_inertia,
        f"{entry.parameters[1]} of {entry.parameters[0]}" if entry.parameters else None,
        entry.seconds,
        entry.memory,
    )


def _joint_table(dataset: Dataset, entries: Sequence[Entry]) -> Table:
    if dataset.kind == "servo":
        names = list(dict.fromkeys(name for entry in entries for name in getattr(entry.score, "joints", {})))
        headings: list[Column | tuple[str, str]] = [("entry", ""), *((name, "mrad") for name in names)]
        rows: list[tuple[Cell, ...]] = [
            (entry.method, *(entry.score.joints.get(name) for name in names))
            for entry in entries
            if isinstance(entry.score, ServoScore)
        ]
        return table_of_rows(f"{dataset.title}: each joint", headings, rows)
    headings = [
        ("joint and entry", ""),
        ("torque", "N·m"),
        ("band", "N·m"),
        ("raw", "N·m"),
        ("at rest", "N·m"),
        ("low speed", "N·m"),
        ("high speed", "N·m"),
    ]
    scored = [(entry.method, entry.score) for entry in entries if isinstance(entry.score, TorqueScore)]
    joints = len(scored[0][1].joints) if scored else 0
    rows = [
        (f"{of.joint}, {method}", of.torque, of.band, of.raw, of.rest, of.low_speed, of.high_speed)
        for joint in range(joints)
        for method, score in scored
        for of in (score.joints[joint],)
    ]
    return table_of_rows(f"{dataset.title}: each joint", headings, rows)
