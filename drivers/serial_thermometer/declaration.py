"""What dynid knows of the driver `serial_thermometer`."""

from __future__ import annotations

from drivers.declaration import DriverDeclaration, SimulatedBackEnd

_SERVING = "sim_drivers.thermometer.server"

DECLARATION = DriverDeclaration(
    driver="drivers.serial_thermometer.driver:SerialThermometerDriver",
    simulated=(SimulatedBackEnd("thermometer", f"{_SERVING}:serve", f"{_SERVING}:serve_beside", arm=False),),
)
