"""What dynid knows of the driver `can_frames`."""

from __future__ import annotations

from drivers.declaration import DriverDeclaration, SimulatedBackEnd

DECLARATION = DriverDeclaration(
    driver="drivers.can_signals.driver:CanFramesDriver",
    budget="drivers.can_signals.budget:table_budget",
    simulated=(SimulatedBackEnd("can", "sim_drivers.can_signals.serving:serve"),),
)
