"""Scale and sign of the current or torque that each servo and motor model reports, with the document that says so.

    python -m studies.motors.current_signs

Read from the tables of `drivers/serial_servos` and `drivers/can_motors`. The sign is that of the servo or motor; a
joint's `direction` turns it over.
"""

from __future__ import annotations

from collections.abc import Iterator

from drivers.can_motors.tables import FAMILIES, motor_family
from drivers.serial_servos.registers import ServoTable, known_models, servo_table

BITS = {"damiao": 12, "cubemars": 12, "robstride": 16}
"""Bits of a torque over both signs; the others send floating-point numbers."""
SIGNS = {"none": "none: a magnitude"}


def rows() -> Iterator[tuple[str, str, str, str, str]]:
    """Model, quantity, a count of it, sign, document."""
    for model in known_models():
        table = servo_table(model)
        if "current" not in table.feedback:
            yield model, "no current", "", "", _document(table, "load")
            continue
        register = table.registers[table.feedback["current"]]
        yield (
            model,
            "current",
            f"{1e3 * register.scale:g} mA",
            SIGNS.get(str(register.sign), str(register.sign)),
            _document(table, "current"),
        )
    for family in FAMILIES:
        motors = motor_family(family)
        for model, scale in motors.models.items():
            count = "a number in N·m"
            if scale.torque is not None:
                count = f"{1e3 * 2.0 * scale.torque / ((1 << BITS[family]) - 1):.3g} mN·m"
            yield model, "torque", count, "with the position's", motors.documents["torque"]


def _document(table: ServoTable, subject: str) -> str:
    """What it says of a subject, named in full."""
    named, manual = table.documents[subject], table.documents["registers"]
    for short, end in (("that manual", ", control"), ("The memory table", ";")):
        named = named.replace(short, manual.split(end)[0])
    return named


def main() -> None:
    """Print the table."""
    print("| model | reports | a count | sign | document |")
    print("|---|---|---|---|---|")
    for row in rows():
        print(f"| {' | '.join(row)} |")


if __name__ == "__main__":
    main()
