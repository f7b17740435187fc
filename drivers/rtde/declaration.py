"""What dynid knows of the driver `rtde`."""

from __future__ import annotations

from drivers.declaration import DriverDeclaration, SimulatedBackEnd
from drivers.rtde.protocol import PORT

DECLARATION = DriverDeclaration(
    driver="drivers.rtde.driver:RtdeDriver",
    port=PORT,
    simulated=(SimulatedBackEnd("rtde", "sim_drivers.rtde.server:serve", stands_in=True, turning=6),),
)
