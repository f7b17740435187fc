"""What dynid knows of the drivers of CAN motors."""

from __future__ import annotations

from drivers.declaration import DriverDeclaration, SimulatedBackEnd


def _of(family: str) -> DriverDeclaration:
    """Return what all have in common: their functions are called after the family."""
    return DriverDeclaration(
        driver=f"drivers.can_motors.driver:{family}",
        budget=f"drivers.can_motors.budget:{family}_budget",
        read_only={"read_only": True},
        reset_faults={"reset_faults": True},
        simulated=(SimulatedBackEnd(family, f"sim_drivers.can_motors.server:serve_{family}"),),
    )


DAMIAO, ROBSTRIDE, CUBEMARS, MOTEUS, ODRIVE = map(_of, ("damiao", "robstride", "cubemars", "moteus", "odrive"))
