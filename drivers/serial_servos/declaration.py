"""What dynid knows of the drivers `feetech` and `dynamixel`."""

from __future__ import annotations

from drivers.declaration import DriverDeclaration, SimulatedBackEnd


def _of(protocol: str) -> DriverDeclaration:
    """Return what both have in common: their functions are called after the protocol."""
    return DriverDeclaration(
        driver=f"drivers.serial_servos.driver:{protocol}",
        budget=f"drivers.serial_servos.budget:{protocol}_budget",
        read_only={"read_only": True},
        configure={"configure": True},
        advice=f"drivers.serial_servos.budget:{protocol}_advice",
        simulated=(SimulatedBackEnd(protocol, f"sim_drivers.serial_servos.server:serve_{protocol}"),),
    )


FEETECH, DYNAMIXEL = _of("feetech"), _of("dynamixel")
