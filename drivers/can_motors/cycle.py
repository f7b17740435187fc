"""The thread that reads and commands all motors again and again, and what it tells of them: rows, losses, faults."""

from __future__ import annotations

import math

from drivers.base import Level
from drivers.can_motors.bus import Feedback, MotorBus
from drivers.can_motors.control import MotorControl
from drivers.can_motors.settings import CanMotorSettings
from drivers.core.clock import Clock
from drivers.polled_rows import PolledRows
from drivers.streams import ENABLED, GOAL_AGE, ChannelLayout

FOLLOWING = 3.0
"""Periods after a goal during which the next one is awaited, so that it is sent when it comes."""
LATE = 1.25
"""Periods after a cycle at which the last goal is sent again, where no new one came."""
TWICE = 5
"""Answers beyond one for each request from which on two motors give them."""
PATIENCE = 1.9
"""Periods that answers are waited for: on a computer that is late, the next goal is, and no row is lost."""
SOONEST = 0.5
"""Periods after a cycle before which no goal is sent."""
UNITS = {"supply_voltage": "V", "drive_temperature": "degC", ENABLED: "1", GOAL_AGE: "s"}
MEANINGS = {
    "torque": "torque that the motor estimates from its current",
    "temperature": "of the motor's windings",
    "drive_temperature": "of the drive's power stage",
    "supply_voltage": "of the motor's supply",
    ENABLED: "1 while the motor drives, 0 while it does not, nan where it does not say",
    GOAL_AGE: "time for which the goal behind this torque had been in force",
}


class MotorCycle(PolledRows):
    """Reads all motors at a rate, with goals while they are moved; a new goal goes out at once."""

    def __init__(self, bus: MotorBus, control: MotorControl, settings: CanMotorSettings, clock: Clock) -> None:
        super().__init__(f"motors {settings.where}", settings.keys.rate, control.sent, clock, settings.gains())
        self._bus, self._control, self._settings = bus, control, settings
        self._motors = settings.motors
        self._quantities = _measured(settings)
        self._strange = self._overdue = 0
        self._doubled: dict[str, Level] = {}
        self._begun = clock.now()
        self._wanted = False
        control.fresh = self._hurry

    def losses(self) -> str:
        """Return why rows were lost, in words; empty where none were."""
        said = [
            super().losses(),
            f"{self._overdue} answers came too late" if self._overdue else "",
            f"{self._strange} frames came from no known motor" if self._strange else "",
            f"answered twice: {', '.join(self._doubled)}" if self._doubled else "",
        ]
        return "; ".join(filter(None, said))

    def _read(self) -> None:
        self._begun = self._clock.now()
        with self._changed:
            self._wanted = False
        patience = PATIENCE * self._period
        feedback = self._control.cycle(patience) if self._control.active else self._bus.cycle(patience=patience)
        self._strange += feedback.strange
        self._overdue += feedback.overdue
        self.besides = f"{feedback.strange} frames came from no known motor" if feedback.strange else ""
        for index, state in feedback.states.items():
            self.answered[self._motors[index].id] = feedback.received
            self._note_fault(index, state.fault)
            if state.enabled is False and self._control.obeying and not state.fault:
                self._tell(
                    "error",
                    f"{self._motors[index].name} no longer drives",
                    "check its power, and whether another program commands it",
                )
            if state.serials > 1 or (state.surplus >= TWICE and not self._bus.codecs[index].unasked):
                self._note_twice(index)
        missing = [motor.name for index, motor in enumerate(self._motors) if index not in feedback.states]
        if missing:
            self._lose(missing, feedback.received)
        else:
            self._add(feedback.time, feedback.received, self._row(feedback))

    def _pause(self, due: float) -> float:
        following = self._clock.now() - self._control.commanded < FOLLOWING * self._period
        if not (self._control.active and following):
            return super()._pause(due)
        with self._changed:
            latest = max(self._begun + LATE * self._period, self._clock.now())
            self._changed.wait_for(lambda: self._wanted or self._ending.is_set(), latest - self._clock.now())
            if (missed := int((self._clock.now() - latest) / self._period)) > 0:
                self._lost += missed
                self._late += missed
        if (soonest := self._begun + SOONEST * self._period) > self._clock.now():
            self._ending.wait(soonest - self._clock.now())
        return self._clock.now()

    def _hurry(self) -> None:
        with self._changed:
            self._wanted = True
            self._changed.notify_all()

    def _row(self, feedback: Feedback) -> dict[str, list[float]]:
        row = {
            quantity: [
                motor.to_joint(quantity, feedback.states[index].values[quantity])
                for index, motor in enumerate(self._motors)
            ]
            for quantity in self._quantities
        }
        states = (feedback.states[index].enabled for index in range(len(self._motors)))
        row[ENABLED] = [math.nan if enabled is None else float(enabled) for enabled in states]
        if not self._settings.keys.read_only:
            ages = feedback.ages if self._control.active else {}
            row[GOAL_AGE] = [
                age if (age := ages.get(index, math.nan)) < math.inf else math.nan for index in range(len(self._motors))
            ]
        return row

    def _note_fault(self, index: int, fault: int) -> None:
        motor = self._motors[index]
        if fault != self._faults.get(index, 0):
            self._faults[index] = fault
            words = motor.address.family.fault_words(fault)
            self._report_fault(motor.name, words, moving=self._control.active)

    def _note_twice(self, index: int) -> None:
        name = self._motors[index].name
        level: Level = "error" if self._control.active else "warning"
        if self._doubled.get(name) == level:
            return
        self._doubled[name] = level
        self._tell(
            level,
            f"{name} answers twice: two motors have this id, or another program commands it",
            "give each motor its own id with the manufacturer's tool",
        )


def feedback_channels(settings: CanMotorSettings) -> tuple[ChannelLayout, ...]:
    """The channels of the stream `joints`: what every motor tells."""
    joints = tuple(motor.joint for motor in settings.motors)
    common = [*_measured(settings), ENABLED] + ([] if settings.keys.read_only else [GOAL_AGE])
    when = "time is the middle of the reading, by this computer's clock"
    return tuple(
        ChannelLayout(quantity, joints, UNITS.get(quantity, ""), f"{MEANINGS.get(quantity, quantity)}; {when}")
        for quantity in common
    )


def _measured(settings: CanMotorSettings) -> list[str]:
    """The quantities that every motor measures."""
    delivered = [codec.quantities(read_only=settings.keys.read_only) for codec in settings.codecs()]
    return [quantity for quantity in delivered[0] if all(quantity in others for others in delivered)]
