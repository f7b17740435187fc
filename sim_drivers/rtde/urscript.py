"""Runs programs in the part of URScript that needs no poses, threads or strings: registers, servoj, stopj, sync.

URScript differs from Python in its `end` lines and in `local` and `global` (Universal Robots, "The URScript Programming
Language"), so a program is read by Python's parser. Its statements are obeyed one by one, and Python evaluates its
expressions where they are of the kinds below: nothing but the words below exists for it. It moves on by a period of the
controller at a time; one that never waits is ended, as the controller ends it.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Generator, Mapping
from functools import partial
from types import CodeType

import numpy as np

from drivers.core.errors import UsageError
from sim_drivers.rtde.controller import Controller
from sim_drivers.rtde.variables import JOINTS, Value

MOVES = frozenset(("servoj", "stopj", "sync"))
"""Functions that take time."""
WORDS = MOVES | {
    "get_steptime",
    "textmsg",
    "read_input_integer_register",
    "read_input_float_register",
    "write_output_integer_register",
}
LARGEST_STEP = 10_000
"""Statements that a program may obey in a period of the controller."""
LOOKAHEAD = 0.1
"""servoj's default [s]."""
_DECLARATION = re.compile(r"^(\s*)(?:local|global)\s+")
_EXPRESSIONS = (
    *(ast.Constant, ast.Name, ast.Load, ast.List, ast.UnaryOp, ast.USub, ast.Not, ast.BoolOp, ast.And, ast.Or),
    *(ast.BinOp, ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Compare, ast.Eq, ast.NotEq, ast.Lt, ast.LtE, ast.Gt, ast.GtE),
    *(ast.Call, ast.keyword),
)
"""What expressions consist of."""
_Run = Generator[None, None, None]
"""Yields once a period."""


class UrscriptProgram:
    """One program.

    Raises:
        UsageError: it is no URScript, or uses a statement that is not simulated.
    """

    def __init__(self, text: str) -> None:
        lines = [_DECLARATION.sub(r"\1", line) for line in text.splitlines() if line.strip() != "end"]
        try:
            module = ast.parse("\n".join(lines))
        except (SyntaxError, ValueError, RecursionError) as error:
            raise UsageError(f"not the URScript that is simulated: {error}") from error
        if len(module.body) != 1 or not isinstance(module.body[0], ast.FunctionDef):
            raise UsageError("not one function")
        called = {ast.unparse(node.func) for node in ast.walk(module) if isinstance(node, ast.Call)}
        if unknown := called - WORDS:
            raise UsageError(f"{', '.join(sorted(unknown))}: not simulated")
        self._body = module.body[0].body
        self._variables: dict[str, object] = {}
        self._compiled: dict[ast.expr, CodeType] = {}
        self._words: dict[str, object] = {}
        self._obeyed = 0
        self._run: _Run | None = None

    def begin(self, controller: Controller) -> None:
        """Start of the program."""
        answers = {name: partial(self._answer, controller, name) for name in WORDS - MOVES}
        self._words = {"__builtins__": {}, **answers}
        self._run = self._block(self._body, controller)

    def kick(self, controller: Controller, received: Mapping[str, Value]) -> None:
        """Nothing: a program watches its registers itself."""

    def step(self, controller: Controller) -> None:
        """One period."""
        assert self._run is not None, "a program begins before it steps"
        self._obeyed = 0
        try:
            next(self._run)
        except StopIteration:
            if controller.script is self:
                controller.stop_program()
        except (UsageError, ArithmeticError, TypeError, ValueError) as error:
            controller.fail_program(f"URScript: {error}")

    def _block(self, statements: list[ast.stmt], controller: Controller) -> _Run:
        for statement in statements:
            self._obeyed += 1
            if self._obeyed > LARGEST_STEP:
                raise UsageError("the program runs without waiting")
            match statement:
                case ast.Assign(targets=[ast.Name(id=name)], value=value):
                    self._variables[name] = self._value(value)
                case ast.If(test=test, body=body, orelse=otherwise):
                    yield from self._block(body if self._value(test) else otherwise, controller)
                case ast.While(test=test, body=body, orelse=[]):
                    while self._value(test):
                        yield from self._block(body, controller)
                case ast.Expr(value=ast.Call(func=ast.Name(id=name)) as call) if name in MOVES:
                    yield from self._move(name, call, controller)
                case ast.Expr(value=ast.Call() as call):
                    self._value(call)
                case _:
                    raise UsageError(f"'{ast.unparse(statement).splitlines()[0]}' is not simulated")

    def _move(self, name: str, call: ast.Call, controller: Controller) -> _Run:
        """A command that takes time."""
        values = [self._value(argument) for argument in call.args]
        named = {keyword.arg: self._value(keyword.value) for keyword in call.keywords}
        if name == "servoj":
            given = dict(zip(("q", "a", "v", "t", "lookahead_time", "gain"), values, strict=False)) | named
            target = np.asarray(given.get("q", ()), dtype=np.float64)
            if target.shape != (JOINTS,):
                raise UsageError(f"servoj takes {JOINTS} positions")
            controller.servo(target, float(given.get("lookahead_time", LOOKAHEAD)))  # type: ignore[arg-type]
            duration = float(given.get("t", controller.period))  # type: ignore[arg-type]
            for _ in range(max(1, round(min(duration, 1.0) / controller.period))):
                yield
        elif name == "stopj":
            motion = controller.brake(float((*values, *named.values())[0]))  # type: ignore[arg-type]
            while not motion.finished:
                yield
        else:
            yield

    def _value(self, expression: ast.expr) -> object:
        if expression not in self._compiled:
            if not _is_simulated(expression):
                raise UsageError(f"'{ast.unparse(expression)}' is not simulated")
            self._compiled[expression] = compile(ast.Expression(expression), "<URScript>", "eval")
        try:
            value = eval(self._compiled[expression], self._words, self._variables)
        except NameError as error:
            raise UsageError(f"'{error.name}' is not simulated") from error
        if isinstance(value, list):
            return np.array([_number(element) for element in value])
        return _number(value) if isinstance(value, int) else value

    def _answer(self, controller: Controller, name: str, *values: object) -> object:
        """Return what a function that takes no time returns."""
        registers = {"read_input_integer_register": "input_int", "read_input_float_register": "input_double"}
        match name, values:
            case "get_steptime", []:
                return controller.period
            case "textmsg", [text]:
                controller.messages.append(str(text))
                return None
            case "read_input_integer_register" | "read_input_float_register", [int(number)]:
                register = f"{registers[name]}_register_{number}"
                if register in controller.values:
                    return controller.values[register]
            case "write_output_integer_register", [int(number), int(value)]:
                if f"output_int_register_{number}" in controller.values and -(2**31) <= value < 2**31:
                    controller.values[f"output_int_register_{number}"] = value
                    return None
        raise UsageError(f"{name} with {len(values)} arguments is not simulated")


def _is_simulated(expression: ast.expr) -> bool:
    """Whether an expression is simulated: lists stand alone, and texts in calls, so that neither is multiplied."""
    nodes = list(ast.walk(expression))
    texts = {argument for node in nodes if isinstance(node, ast.Call) for argument in node.args}
    for node in nodes:
        if not isinstance(node, _EXPRESSIONS) or (isinstance(node, ast.List) and node is not expression):
            return False
        if isinstance(node, ast.Constant) and not isinstance(node.value, int | float) and node not in texts:
            return False
    return True


def _number(value: object) -> float:
    """A number that a controller holds.

    Raises:
        UsageError: it is none, or an integer of more than 32 bits.
    """
    if not isinstance(value, int | float) or (isinstance(value, int) and not -(2**31) <= value < 2**31):
        raise UsageError("a value is not a number that the controller holds")
    return value
