"""What dynid knows of this bus; pyproject.toml names it in the group `dynid.drivers`."""

from drivers.declaration import DriverDeclaration, SimulatedBackEnd

DECLARATION = DriverDeclaration(
    driver="toy_bus.driver:ToyBusDriver",
    budget="toy_bus.driver:budget",
    simulated=(SimulatedBackEnd("toy_bus", "toy_bus.simulated:serve"),),
)
