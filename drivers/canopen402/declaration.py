"""What dynid knows of the driver `canopen402`."""

from __future__ import annotations

from drivers.declaration import DriverDeclaration, SimulatedBackEnd

DECLARATION = DriverDeclaration(
    driver="drivers.canopen402.driver:Canopen402Driver",
    budget="drivers.canopen402.budget:canopen_budget",
    read_only={"mode": "none"},
    reset_faults={"reset_faults": True},
    simulated=(
        SimulatedBackEnd("canopen", "sim_drivers.canopen.serving:serve", stands_in=True),
        SimulatedBackEnd("slcan", "sim_drivers.canopen.serving:serve_behind_adapter"),
    ),
)
