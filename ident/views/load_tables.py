"""Tables of a load on the tool, and of drive gains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from drivers.core.text import percent_text
from drivers.core.units import common_unit
from ident.estimators.feasible.pseudo_inertia import INERTIA_ELEMENTS
from ident.experiments.gains.drive_gains import DriveGains
from ident.experiments.gains.up_and_down import SlowGainsResult
from ident.experiments.load.consistent_load import ConsistentLoad
from ident.experiments.load.load_estimate import LoadParameter
from ident.experiments.load.payload import Payload
from ident.linear_algebra.independent_columns import DETERMINED
from ident.result.tables import Column, Table, table_of, table_of_rows
from ident.views.number_text import with_error

VALUE, STD, UNIT = Column("value"), Column("std", label="σ", kind="std"), Column("unit")


def payload_tables(result: Payload) -> list[Table]:
    """The load without and with what is known of it, as a body, and what it changes."""
    tables = [load_table(result.load)]
    if result.load_with_known is not None:
        tables.append(load_table(result.load_with_known, "Load with the known parameters held fixed"))
    centre = result.centre_of_mass
    if centre is not None:
        tables[-1] = replace(tables[-1], note=f"Centre of mass [m]: {_intervals(centre.value, centre.std)}.")
    if result.consistent_load is not None:
        tables.append(body_table(result.consistent_load))
    return [*tables, changes_table(result)]


def load_table(rows: Sequence[LoadParameter], title: str = "Load") -> Table:
    """Identifiable combinations of the load's ten parameters, in the tool frame."""
    by_cause = (Column("noise_std", label="σ by noise", digits=3), Column("gain_std", label="σ by gains", digits=3))
    columns = (Column("name"), Column("expression", kind="detail"), VALUE, STD, UNIT, *by_cause)
    return table_of(title, columns, rows)


def body_table(load: ConsistentLoad) -> Table:
    """The load as a body that can exist: mass, centre of mass and the inertia about it, and where each is from."""
    axes = zip("xyz", load.com, load.com_std, strict=True)
    rows = [
        ("mass", load.mass, load.mass_std, "kg", _origin(load, "M_L")),
        *((axis, value, std, "m", _origin(load, f"M{axis.upper()}_L")) for axis, value, std in axes),
        *(
            (f"I{name}", load.inertia[name], load.inertia_std[name], "kg·m²", _origin(load, f"{name.upper()}_L"))
            for name in INERTIA_ELEMENTS
        ),
    ]
    title = "Physically consistent load: centre of mass, and inertia about it"
    return table_of_rows(title, (Column("name"), VALUE, STD, UNIT, Column("from")), rows)


def _origin(load: ConsistentLoad, parameter: str) -> str:
    if parameter in load.held:
        return "known"
    share = load.determined[parameter]
    return "data" if share >= DETERMINED else f"{percent_text(share)} data, else prior"


def changes_table(result: Payload) -> Table:
    """Base parameters that the load changes, as in SR400 Table 4."""
    columns = (
        Column("name"),
        UNIT,
        Column("free"),
        Column("free_std", label="σ", kind="std"),
        Column("predicted", label="free plus load"),
        Column("loaded"),
        Column("loaded_std", label="σ", kind="std"),
    )
    return table_of("Base parameters that a load changes", columns, result.base_parameters)


def gains_tables(result: DriveGains | SlowGainsResult) -> list[Table]:
    """The gains beside those of the robot file, and the parameters that were identified with them."""
    columns = [
        Column("joint"),
        Column("gain", unit=result.unit),
        Column("std", unit=result.unit, label="σ", kind="std"),
        Column("rsd_percent", unit="%", label="RSD"),
        Column("file_gain", unit=result.unit, label="robot file"),
        Column("change", unit="%"),
    ]
    if isinstance(result, SlowGainsResult):
        sliding = [gain.sliding for gain in result.gains]
        speed, torque = common_unit("rad/s", sliding), common_unit("N·m", sliding)
        columns += [
            Column("sweeps", label="poses"),
            Column("positions"),
            Column("speed", unit=speed, digits=3),
            Column("friction_free", unit=torque, digits=3),
            Column("friction_loaded", unit=torque, digits=3),
        ]
        table = table_of("Drive gains, joint side, by half sums of slow runs up and down", columns, result.gains)
        if result.known.com is None:
            mass, load = result.known.mass, result.load
            figures = ([row.value for row in load], [row.std for row in load])
            centre, std = ([None if entry is None else entry / mass for entry in row] for row in figures)
            table = replace(table, note=f"Centre of mass of the load [m]: {_intervals(centre, std)}.")
        return [table]
    columns += [
        Column("angle_degrees", unit="°", label="angle", digits=3),
        Column("confused_with", label="confounded with"),
        Column("correlation", digits=2),
    ]
    parameters = [row for row in result.base_parameters if row.value is not None]
    return [
        table_of("Drive gains, joint side", columns, result.gains),
        table_of("Base parameters with these gains; σ includes that of the gains", BASE, parameters),
    ]


BASE = (Column("name"), VALUE, STD, UNIT)


def _intervals(values: Sequence[float | None], deviations: Sequence[float | None]) -> str:
    """Values, each with half of its 95 % interval."""
    return ", ".join(with_error(value, std) for value, std in zip(values, deviations, strict=True))
