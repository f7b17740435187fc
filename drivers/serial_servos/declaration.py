"""What dynid knows of the drivers `feetech` and `dynamixel`."""

from __future__ import annotations

from drivers.declaration import DriverDeclaration, SimulatedBackEnd

FEETECH = DriverDeclaration(
    driver="drivers.serial_servos.driver:feetech",
    budget="drivers.serial_servos.budget:feetech_budget",
    read_only={"read_only": True},
    configure={"configure": True},
    advice="drivers.serial_servos.budget:feetech_advice",
    simulated=(SimulatedBackEnd("feetech", "sim_drivers.serial_servos.serving:serve_feetech"),),
)
DYNAMIXEL = DriverDeclaration(
    driver="drivers.serial_servos.driver:dynamixel",
    budget="drivers.serial_servos.budget:dynamixel_budget",
    read_only={"read_only": True},
    configure={"configure": True},
    advice="drivers.serial_servos.budget:dynamixel_advice",
    simulated=(SimulatedBackEnd("dynamixel", "sim_drivers.serial_servos.serving:serve_dynamixel"),),
)
