"""The part of URScript that simulated controllers run."""

from __future__ import annotations

import pytest
from each import each

from daq.robot.loader import load_robot
from drivers.core.errors import UsageError
from sim_drivers.plant.plant import Plant
from sim_drivers.rtde.controller import Controller
from sim_drivers.rtde.urscript import UrscriptProgram
from sim_drivers.rtde.variables import parse_version


@pytest.fixture(scope="module")
def controller() -> Controller:
    return Controller(Plant(load_robot("ur5e"), seed=1), parse_version("5.22"), 0.002)


def run(controller: Controller, body: str, periods: int = 5) -> int:
    """Output register 24 after so many periods of a program."""
    lines = "".join(f"  {line}\n" for line in body.splitlines())
    controller.start_program(UrscriptProgram(f"def program():\n{lines}end\n"))
    for _ in range(periods):
        controller.step()
    controller.stop_program()
    return int(controller.values["output_int_register_24"])  # type: ignore[arg-type]


@each(
    ("body", "result"),
    [
        ("write_output_integer_register(24, 7)", 7),
        ("local x = 3\nif x > 2 and not x == 4:\n  write_output_integer_register(24, -8)\nend", -8),
        ("x = 0\nwhile x < 3:\n  x = x + 1\n  write_output_integer_register(24, x)\n  sync()\nend", 3),
        ("if 1 == 2:\n  sync()\nelif 2 == 2:\n  write_output_integer_register(24, 5)\nelse:\n  sync()\nend", 5),
    ],
)
def test_statements_mean_what_the_manual_says(controller: Controller, body: str, result: int) -> None:
    assert run(controller, body) == result
    assert controller.script is None


@each(
    ("body", "reason"),
    [
        ("while True:\n  x = 1\nend", "without waiting"),
        ("x = 1 / 0", "division by zero"),
        ("y = z", "'z' is not simulated"),
        ("servoj([0, 0])", "takes 6 positions"),
        ("get_steptime(1)", "get_steptime with 1 arguments is not simulated"),
        ("write_output_integer_register(24, 99999999999)", "is not simulated"),
        ("x = (1).real", "is not simulated"),
        ("import os", "is not simulated"),
        ("x = [1][0]", "is not simulated"),
        ("x = [0] * 9999999999", "is not simulated"),
        ("x = (1 and [0]) * 9999999999", "is not simulated"),
        ("x = 'a'", "is not simulated"),
        ("x = [0]\ny = [x, x]", "not a number"),
        ("x = 2\nwhile True:\n  x = x * x\nend", "not a number that the controller holds"),
    ],
)
def test_what_is_not_simulated_ends_the_program(controller: Controller, body: str, reason: str) -> None:
    run(controller, body)
    assert reason in controller.messages[-1]
    assert controller.script is None


@each(
    "text",
    [
        "",
        "x = 1",
        "def f(:\nend",
        "def f():\n  x = 1\nend\ndef g():\n  x = 1\nend",
        "\0",
        "def f():\n  movej([0, 0])\nend",
    ],
)
def test_what_is_not_urscript_is_refused(text: str) -> None:
    with pytest.raises(UsageError):
        UrscriptProgram(text)
