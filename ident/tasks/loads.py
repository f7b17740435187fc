"""Payload, or drive gains, from a run without and a run with a load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan

import numpy as np

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from drivers.core.options import keywords_of
from ident.experiments.gains.drive_gains import DriveGains, identify_gains
from ident.experiments.gains.up_and_down import SlowGainsResult, identify_slow_gains
from ident.experiments.load.consistent_load import ConsistentLoad
from ident.experiments.load.payload import Payload, identify_payload
from ident.model.load import KnownLoad
from ident.report.load_pages import gains_page, payload_page
from ident.result.tables import Table
from ident.tasks.arguments import SavedResult, recording_of
from ident.tasks.options import GainsOptions, LoadOptions
from ident.views.load_tables import changes_table, gains_tables, load_table

Vector = Sequence[float] | FloatArray

PAYLOAD_FILE, GAINS_FILE = "payload.json", "gains.json"
"""Names of the results in the folders that `save` writes."""


@dataclass(frozen=True)
class IdentifiedPayload(SavedResult):
    """The load on an arm's tool, in the tool frame; σ includes noise and the drive gains' uncertainty.

    Attributes:
        result: all of it, as `payload.json` holds it.

    Example:
        >>> import dynid
        >>> free, loaded = (dynid.simulate("ur5e", duration=10.0, seed=seed) for seed in (1, 2))
        >>> load = dynid.payload(free, loaded)  # here both runs are without a load
        >>> abs(load.mass) < 5 * load.mass_std + 1
        True
        >>> load.parameters.row("M_L")["unit"]
        'kg'
    """

    FILE = PAYLOAD_FILE

    result: Payload

    @property
    def mass(self) -> float:
        """Mass identified without knowledge of the load [kg]; NaN where it is not identifiable."""
        return nan if self.result.mass is None else self.result.mass.value

    @property
    def mass_std(self) -> float:
        """Return its standard deviation σ [kg]."""
        return nan if self.result.mass is None else self.result.mass.std

    @property
    def com(self) -> FloatArray | None:
        """Centre of mass (3,) [m], with known parameters held fixed; None where it is not identifiable."""
        centre = self.result.centre_of_mass
        return None if centre is None else np.array(centre.value)

    @property
    def com_std(self) -> FloatArray | None:
        """Return its standard deviations σ (3,) [m]."""
        centre = self.result.centre_of_mass
        return None if centre is None else np.array(centre.std)

    @property
    def body(self) -> ConsistentLoad | None:
        """The load as a body that can exist: `.body.mass` [kg], `.body.com` [m], `.body.inertia` by element [kg·m²].

        With `.mass_std`, `.com_std`, `.inertia_std` and what it costs, as in `payload.json`; None where none was found.
        """
        return self.result.consistent_load

    @property
    def parameters(self) -> Table:
        """The identifiable combinations of the load's ten parameters, with known ones held fixed."""
        return load_table(self.result.load_with_known or self.result.load)

    @property
    def changes(self) -> Table:
        """Base parameters that a load changes: without it, predicted and identified with it (SR400 Table 4)."""
        return changes_table(self.result)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The hypothesis tests in words: does a load, and does the known one, explain what changed?"""
        return tuple(self.result.sentences)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the checks."""
        return tuple(self.result.warnings)

    def _page(self) -> str:
        return payload_page(self.result)

    def __repr__(self) -> str:
        return f"<dynid.IdentifiedPayload: {self.mass:.4g} kg, σ {self.mass_std:.2g} kg>"

    def _parts(self) -> tuple[object, ...]:
        return self.parameters, "\n".join([*self.sentences, *(f"warning: {warning}" for warning in self.warnings)])

    def _repr_html_(self) -> str:
        return super()._repr_html_() + self.changes._repr_html_()


@dataclass(frozen=True)
class IdentifiedGains(SavedResult):
    """Gains of all drives, joint side, sign included; torque = gain · signal.

    Attributes:
        result: all of it, as `gains.json` holds it.

    Example:
        >>> import dynid
        >>> dynid.IdentifiedGains.gains.__doc__.split(";")[0]
        "One row per joint: the identified gain with its σ, the robot file's [N·m/A or N·m/V], its basis."
    """

    FILE = GAINS_FILE

    result: DriveGains | SlowGainsResult

    @property
    def values(self) -> FloatArray:
        """Gains (n,) [N·m/A or N·m/V]; NaN where one is not identifiable."""
        return self.result.values

    @property
    def std(self) -> FloatArray:
        """Their standard deviations σ (n,), in the same unit."""
        return self.result.std

    @property
    def gains(self) -> Table:
        """One row per joint: the identified gain with its σ, the robot file's [N·m/A or N·m/V], its basis."""
        return gains_tables(self.result)[0]

    @property
    def robot_file_text(self) -> str:
        """The robot file's section `drives` with these gains."""
        return self.result.robot_file_text

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the checks."""
        return tuple(self.result.warnings)

    def _page(self) -> str:
        return gains_page(self.result)

    def __repr__(self) -> str:
        gains = ", ".join(f"{row['joint']} {row['gain']:.4g}" for row in self.gains)
        return f"<dynid.IdentifiedGains: {gains}>"

    def _parts(self) -> tuple[object, ...]:
        return self.gains, "\n".join(f"warning: {warning}" for warning in self.warnings)


@keywords_of(LoadOptions)
def payload(options: LoadOptions) -> IdentifiedPayload:
    """Identify the load on the tool, and test whether a load explains the change between the runs (SR400 .4.4).

    Raises:
        UsageError: com or inertia without a mass, or an impossible body.
        DataError: different arms, no torque, no identifiable load parameter.
        IdentificationError: there is no solution.

    Example:
        >>> import dynid
        >>> free, loaded = (dynid.simulate("ur5e", duration=10.0, seed=seed) for seed in (1, 2))
        >>> "M_L" in dynid.payload(free, loaded).parameters.names
        True
    """
    pair, known, robot_file = _given(options)
    return IdentifiedPayload(identify_payload(*pair, known, robot_file, options.delay))


@keywords_of(GainsOptions)
def drive_gains(options: GainsOptions) -> IdentifiedGains:
    """Identify the gains of all drives from a run without and a run with a load of known mass (Gautier, Briot 2014).

    Raises:
        UsageError: an impossible body.
        DataError: different arms, or no motor signal.
        IdentificationError: there is no solution.

    Example:
        >>> import dynid
        >>> dynid.drive_gains("free.h5", "loaded.h5", mass=2.8)
        Traceback (most recent call last):
        drivers.core.errors.RecordingError: free.h5: no such file
    """
    pair, known, robot_file = _given(options)
    assert known is not None
    identify = identify_slow_gains if options.up_and_down else identify_gains
    return IdentifiedGains(identify(*pair, known, robot_file, options.delay))


def _given(options: LoadOptions) -> tuple[tuple[Recording, Recording], KnownLoad | None, RobotFile | None]:
    """The recordings, the load where it was weighed, and the robot file where one was given."""
    known = None if options.mass is None else _known_load(options.mass, options.com, options.inertia)
    pair = recording_of(options.free), recording_of(options.loaded)
    return pair, known, None if options.robot is None else load_robot(options.robot)


def _known_load(mass: float, com: Vector | None, inertia: Vector | None) -> KnownLoad:
    try:
        vectors = [None if given is None else tuple(float(value) for value in given) for given in (com, inertia)]
        return KnownLoad(float(mass), *vectors)
    except (TypeError, ValueError) as error:
        raise UsageError("mass, com and inertia are numbers: kg, three of m, six of kg·m²") from error
