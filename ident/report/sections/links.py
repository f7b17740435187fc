"""Links of the physically consistent model, and what it costs that they can exist."""

from __future__ import annotations

from collections.abc import Sequence

from ident.assessment.validation import Fit
from ident.report.section import ReportData, ReportSection, Tile
from ident.result.consistent_model import ConsistentModel
from ident.views.number_text import number, percent


def section(data: ReportData) -> ReportSection | None:
    """The links' bodies; None where no consistent model was found."""
    result = data.result
    if result.consistent is None or not result.standard_parameters:
        return None
    consistent = result.consistent
    context = {
        "links": result.standard_parameters,
        "joints": [entry for entry in consistent.parameters if entry.unit and not _of_link(entry.name)],
        "consistent": consistent,
        "simulated": _simulated(result.joints, consistent),
        "names": result.joints,
        "open_loop": [] if result.delivered is None else [run for run in result.delivered.runs if run.open_loop],
        "tiles": _tiles(consistent, result.validation),
    }
    return ReportSection("Links", "links", "links.html.j2", context)


def _simulated(joints: Sequence[str], consistent: ConsistentModel) -> list[tuple[str, float | None, float, float]]:
    """Torque error [N·m], motion error and its largest value [rad or m] of each joint on held-out data."""
    if consistent.simulation is None or consistent.validation is None:
        return []
    motion = consistent.simulation
    return list(zip(joints, consistent.validation.rmse, motion.position_rmse, motion.max_position_error, strict=True))


def _of_link(name: str) -> bool:
    return name.rstrip("0123456789") in ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M")


def _tiles(consistent: ConsistentModel, unconstrained: Fit | None) -> tuple[Tile, ...]:
    tiles = []
    if consistent.validation is not None:
        free = None if unconstrained is None else unconstrained.relative_error
        tiles.append(
            Tile(
                "Validation error, consistent",
                percent(consistent.validation.relative_error),
                f"unconstrained: {percent(free)}",
            )
        )
    tiles.append(Tile("p-value of consistency", number(consistent.p_value, 2), "small: no bodies explain the data"))
    return tuple(tiles)
