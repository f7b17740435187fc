"""What every simulated device is to `dynid sim`, whatever its bus."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, Self

from drivers.core.options import Options, argument, option
from drivers.core.ranges import Range
from ident.ranges import SEED

DEMO_TIME = Range(2.0, 3600.0, "s")
"""Duration of the demonstration's motion."""


@dataclass(frozen=True, kw_only=True)
class DemoOptions(Options):
    """Options of the demonstration."""

    out: Path = option(Path("demo"), "Folder for the recordings, result.json, report.html.", short="-o")
    robot: str = option("ur5e", "UR arm: built-in, or a robot file with a truth section.")
    duration: float = option(30.0, "Length of the identification motion [s].", allowed=DEMO_TIME)
    seed: int = option(1, "Seed of the motion and the noise.", allowed=SEED)


@dataclass(frozen=True, kw_only=True)
class SimOptions(Options):
    """Options of a simulated arm: which one, its bus, how both differ from the robot file's."""

    robot: str = field(metadata=argument("robot", "Built-in robot or robot file with a truth section."))
    wire: str | None = option(
        None, "rtde, canopen, slcan (CANopen), can, thermometer, or as dynid driver lists; default: its robot file's."
    )
    host: str = option("127.0.0.1", "Address to listen on; several arms: 127.0.0.2, 127.0.0.3.")
    version: str = option("5.22", "Controller version: 3.15 (125 Hz), 5.22, 5.23, 10.10.")
    interface: str | None = option(None, "CAN interface; default: the robot file's.")
    channel: str | None = option(None, "CAN channel; default: the robot file's.")
    swap: str | None = option(None, "Two joints, j1,j2, whose drives have swapped node ids.")
    worst_stuffing: bool = option(False, "Give every CAN frame the maximum of stuff bits.")
    thermometer: bool = option(False, "Also serve its serial thermometer.")
    payload: str | None = option(None, "MASS@X,Y,Z: kg, and m in the flange frame.")
    contact: str | None = option(
        None, "Contacts, separated by ';': push LINK FX FY FZ for S after S; wall …; pick MASS after S."
    )
    position: str | None = option(None, "Initial position of each joint [rad or m]; default: mid-range.")
    seed: int = option(1, "Of the noise.", allowed=SEED)
    play: Path | None = option(None, "Servo arms: motion to play and record instead of serving.")
    out: Path | None = option(None, "With --play: recording to write (.h5).", short="-o")


class Served(Protocol):
    """A simulated device on any bus; entering its context starts it, leaving stops it.

    Attributes:
        failure: the error that ended it; None while it runs.
    """

    messages: deque[str]  # for the terminal, oldest first

    @property
    def failure(self) -> BaseException | None: ...  # noqa: D102

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...

    def ready(self) -> Mapping[str, object]:
        """Address for clients; known once started."""

    def live_line(self) -> str:
        """Return its state in one line."""

    def obey(self, line: str) -> None:
        """Cause a fault as a person types it.

        Raises:
            UsageError: not a fault.
        """
