"""The monitor in a running session: samples become residuals while they arrive, contacts become events."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import numpy as np

from daq.recording.recording import COMMANDS_STREAM, JOINTS_STREAM, Channel, Stream
from drivers.core.arrays import FloatArray
from drivers.core.errors import DynidError, UsageError
from drivers.core.text import counted
from drivers.streams import GOAL_AGE, MOTOR_ON, Batch, StreamLayout, motors_on
from ident.monitor.contact_forces import expected_delay
from ident.monitor.interval_torque import JointSamples
from ident.monitor.load_estimate import changed_load
from ident.monitor.monitor import Contact, Monitor, WatchedBatch
from ident.monitor.thresholds import SAME_RATE, STD_EVERY, Thresholds
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.result.models.model import Model
from ident.signals.joint_signals import TEMPERATURE, live_signals, with_even_goals

TOGETHER = 0.01
"""Samples of this time [s] are evaluated at once: one by one would take several times as long."""
SHOWN_JOINTS, SHOWN_CONTACTS = 8, 4
"""Lines on the terminal."""
AMBIENT = 25.0
"""[°C] of samples that warm up."""
BLIND = 1.0
"""[s] without a residual after which that is said."""
GOALS_KEPT = 8
"""Batches of goals, the newest of which explain the torques of those who follow them in steps."""
SHOWN_EVERY = 0.15
"""[s] between two evaluations of what is shown."""


class Page(Protocol):
    """A page that draws residuals; `daq.live.page.BrowserPage` is one."""

    def append(self, time: FloatArray, rows: FloatArray) -> None:
        """Show rows (N, C) of the channels at times (N,) [s]."""


class LiveMonitor:
    """Watches a session; a `daq.session.watch.Watch`.

    Args:
        model: of the arm.
        thresholds: of its residual.
        stops: whether a contact ends a motion.

    Attributes:
        alarm: called with each contact's time [s], text and joint.
        page: where rows of `page_channels` are drawn; None for nowhere.
        monitor: what has been noticed.
        newest: the residuals of the last samples; None before.
        failure: why nothing is watched any more, in words; empty while all is well.
    """

    def __init__(self, model: Model, thresholds: Thresholds, *, stops: bool = False) -> None:
        self.page: Page | None = None
        self.alarm: Callable[[float, str, str], None] = lambda time, text, joint: None
        self.monitor = Monitor(model, thresholds)
        self.newest: WatchedBatch | None = None
        self.failure = ""
        self._model, self._stops = model, stops
        self._robot = model.stored.robot_file.robot
        self._channels: dict[str, tuple[str, ...]] = {}
        self._goal_channels: dict[str, tuple[str, ...]] = {}
        self._goals: deque[Batch] = deque(maxlen=GOALS_KEPT)
        self._thermometers: dict[str, tuple[list[int], list[int]]] = {}
        self._celsius = np.full(model.dof, np.nan)
        self._heated = np.array(model.dynamics.model.needs("temperature"))
        self._needs_temperature = bool(self._heated.any())
        self._maps: dict[str, FloatArray] = {}
        self._order = np.arange(model.dof)
        self._waiting: list[Batch] = []
        self._on: dict[str, bool] = {}  # quantity of status → whether every motor is on by it
        self._unheard = 0
        self._heard = np.nan
        self._shown: tuple[float, tuple[str, ...]] = (-np.inf, ())

    def begin(self, layouts: Sequence[StreamLayout]) -> None:
        """Prepare for the streams of an opened driver.

        Raises:
            UsageError: there are no positions and torques of the joints, or they come at another rate than those that
                the thresholds were learnt from.
        """
        names = self._model.joint_names
        for layout in layouts:
            channels = {channel.quantity: channel.columns for channel in layout.channels}
            if layout.name == JOINTS_STREAM:
                self._channels = channels
            elif layout.name == COMMANDS_STREAM:
                self._goal_channels = channels
            heated = [joint for joint in channels.get(TEMPERATURE, ()) if joint in names]
            if heated:
                places = [channels[TEMPERATURE].index(joint) for joint in heated]
                self._thermometers[layout.name] = [names.index(joint) for joint in heated], places
        rate = next((layout.rate for layout in layouts if layout.name == JOINTS_STREAM), None)
        if rate is None:
            raise UsageError("this connection has no joint stream to monitor")
        learnt = 1.0 / self.monitor.thresholds.period
        if rate > 0.0 and abs(rate - learnt) > SAME_RATE * learnt:
            raise UsageError(
                f"the connection delivers {rate:g} Hz, but the thresholds were learnt at {learnt:.4g} Hz",
                hint="--quiet names a recording without contact over this connection",
            )
        self._maps = self._torque_maps()
        self._warm_up()

    def _warm_up(self) -> None:
        """Evaluate once what is made at its first use: a session must not wait for it."""
        still = np.zeros((2 * STD_EVERY, self._model.dof))
        time = self.monitor.thresholds.period * np.arange(len(still), dtype=np.float64)
        scratch = Monitor(self._model, self.monitor.thresholds)
        scratch.add(JointSamples(time, still, still, np.full_like(still, AMBIENT)))
        _ = scratch.wrench, scratch.load

    def add(self, batch: Batch) -> None:
        """Note a batch; where it cannot be watched, `failure` says why."""
        if batch.stream in self._thermometers and len(batch.time):
            joints, columns = self._thermometers[batch.stream]
            celsius = batch.values[TEMPERATURE][-1, columns]
            self._celsius[joints] = np.where(np.isfinite(celsius), celsius, self._celsius[joints])
        for quantity in MOTOR_ON.keys() & batch.values.keys():
            if len(batch.time):
                self._on[quantity] = bool(motors_on(quantity, batch.values[quantity]).all())
        if batch.stream == COMMANDS_STREAM and GOAL_AGE in self._channels and len(batch.time):
            self._goals.append(batch)
        if batch.stream != JOINTS_STREAM or not len(batch.time) or self.failure:
            return
        self._heard = float(batch.time[-1])
        if not all(self._on.values()):
            self._waiting = []
            return
        if self._lacks_temperature():
            return
        self._waiting.append(batch)
        if batch.time[-1] - self._waiting[0].time[0] < TOGETHER - 1.5 * self.monitor.thresholds.period:
            return
        batches, self._waiting = self._waiting, []
        try:
            residuals = self.monitor.add(self._samples(batches))
        except Exception as error:  # neither a recording nor an arm that moves may break by it; `stop_reason` says it
            self.failure = f"contacts are no longer monitored: {error}"
            return
        if len(residuals.external):
            self.newest = residuals
            self._draw(residuals)

    def _draw(self, residuals: WatchedBatch) -> None:
        if self.page is None:
            return
        intervals = residuals.intervals
        predicted = intervals.measured + intervals.external
        parts = (intervals.position, intervals.measured, predicted, residuals.external, residuals.threshold)
        self.page.append(intervals.time, np.concatenate(parts, axis=1))

    def _lacks_temperature(self) -> bool:
        return self._needs_temperature and bool(np.isnan(self._celsius[self._heated]).any())

    def _torque_maps(self) -> dict[str, FloatArray]:
        """Quantity → (c, n) what its columns add to the joints' torques, which are linear in all of them.

        Raises:
            UsageError: there are no positions and torques of the joints.
        """
        columns = self._channels
        maps = {}
        for quantity, names in columns.items():
            count = len(names)
            rows = {name: np.zeros((count, len(others))) for name, others in columns.items()}
            rows[quantity] = np.eye(count)
            stamps = np.zeros(count)
            channels = {name: Channel(name, values, "", columns[name]) for name, values in rows.items()}
            try:
                position, torque = live_signals(
                    Stream(JOINTS_STREAM, stamps, stamps, channels), self._robot, "this connection"
                )
            except DynidError as error:
                raise UsageError(str(error)) from error
            if quantity == "position":
                self._order = np.argmax(position, axis=0)
            if torque.any():
                maps[quantity] = torque @ self._model.coupling
        return maps

    def _samples(self, batches: Sequence[Batch]) -> JointSamples:
        used = {"position", GOAL_AGE, *self._maps}
        joints = _joined(
            JOINTS_STREAM, batches, {name: self._channels[name] for name in self._channels if name in used}
        )
        if self._goals:
            joints = with_even_goals(joints, _joined(COMMANDS_STREAM, self._goals, self._goal_channels))
        time = joints.time
        position = joints.channels["position"].values[:, self._order]
        torque = np.zeros_like(position)
        for quantity, shares in self._maps.items():
            torque += joints.channels[quantity].values @ shares
        measured = np.isfinite(self._celsius).any()
        celsius = self._celsius[None].repeat(len(time), axis=0) if measured else None
        return JointSamples(time, position, torque, celsius)

    def events(self) -> Sequence[tuple[float, str]]:
        """The contacts that began since the last call."""
        begun = self.monitor.contacts[self._unheard :]
        self._unheard += len(begun)
        for contact in begun:
            self.alarm(contact.time, contact_text(contact), contact.joint)
        return [(contact.time, contact_text(contact)) for contact in begun]

    def stop_reason(self) -> str:
        """Return why a motion must not go on, where contacts end it."""
        if not self._stops:
            return ""
        if self.failure:
            return self.failure
        lasting = [contact for contact in self.monitor.contacts if np.isnan(contact.end)]
        return contact_text(lasting[-1]) if lasting else ""

    def lines(self) -> Sequence[str]:
        """Joints, load, wrench and the last contacts, a line each."""
        if self.failure:
            return (self.failure,)
        if not all(self._on.values()):
            return ("no external torque: a motor is off",)
        if self.newest is None or self._heard - self.newest.intervals.time[-1] > BLIND:
            lacking = "a temperature" if self._lacks_temperature() else "samples with positions and torques"
            return (f"no external torque: {lacking} of every joint must come first",)
        now = float(self.newest.intervals.time[-1])
        if now - self._shown[0] >= SHOWN_EVERY:
            self._shown = now, tuple(self._said(self.newest))
        return self._shown[1]

    def _said(self, newest: WatchedBatch) -> list[str]:
        external, threshold = newest.external[-1], newest.threshold[-1]
        largest = np.argsort(-np.abs(external) / threshold)[:SHOWN_JOINTS]
        units = [joint.unit("N·m") for joint in self._robot.joints]
        width = max(len(name) for name in self._model.joint_names)
        said = [
            f"{self._model.joint_names[joint]:<{width}}  external {external[joint]:+8.2f} {units[joint]}, contact from "
            f"{threshold[joint]:.2f}; drive {newest.intervals.measured[-1, joint]:+8.2f}"
            for joint in sorted(largest.tolist())
        ]
        wrench = self.monitor.wrench
        if wrench is not None:
            margins = WITHIN_95_PERCENT * np.sqrt(np.diag(wrench.covariance))[:3]
            parts = [f"{value:+.1f} ± {margin:.1f}" for value, margin in zip(wrench.force, margins, strict=True)]
            said.append(f"force at the tool, x y z of the base [N]: {', '.join(parts)}")
        load = self.monitor.load
        moving = np.any(newest.way[-1] != 0)
        if load is not None:
            frozen = "" if moving else ", frozen while the arm rests"
            said.append(f"load {load.mass:.2f} ± {load.margin:.2f} kg, from {load.seconds:.0f} s in motion{frozen}")
            if self.monitor.contacts and (carried := changed_load(load)):
                said.append(carried)
        intervals = newest.intervals
        said += self.monitor.thresholds.beyond(self._model.joint_names, intervals.velocity, intervals.celsius)
        said.append(f"{counted(len(self.monitor.contacts), 'contact')}; no safety function")
        latest = self.monitor.contacts[-SHOWN_CONTACTS:]
        return [*said, *(f"  {now_or_end(contact, newest)}: {contact_text(contact)}" for contact in latest)]

    @property
    def delay(self) -> float:
        """Expected time [s] until a force of twice the smallest is noticed, with the wait for samples together."""
        return expected_delay(self.monitor.thresholds, self.monitor.lag) + TOGETHER / 2.0


def _joined(name: str, batches: Sequence[Batch], columns: Mapping[str, tuple[str, ...]]) -> Stream:
    """Batches as a stream."""
    time = np.concatenate([batch.time for batch in batches])
    channels = {
        quantity: Channel(quantity, np.concatenate([batch.values[quantity] for batch in batches]), "", names)
        for quantity, names in columns.items()
    }
    return Stream(name, time, time, channels)


def page_channels(model: Model) -> tuple[str, ...]:
    """The channels of a page's rows; `residual` is the external torque through the observer."""
    quantities = ("position", "measured", "predicted", "residual", "band")
    return tuple(f"{quantity}/{joint}" for quantity in quantities for joint in model.joint_names)


def contact_text(contact: Contact) -> str:
    """A contact in words."""
    return (
        f"contact: external torque on {contact.joint} {contact.torque:+.3g} {contact.unit}, threshold "
        f"{contact.threshold:.3g}"
    )


def now_or_end(contact: Contact, newest: WatchedBatch) -> str:
    """Say that a contact lasts, or how long ago it was."""
    if np.isnan(contact.end):
        return "now"
    return f"{float(newest.intervals.time[-1]) - contact.end:.0f} s ago"
