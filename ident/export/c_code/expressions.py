"""Arithmetic expressions with common parts shared, simplified while they are built.

An expression is a node of a graph and a sign. Equal nodes are stored once (hash-consing), signs move out of products
and sums, operands of commutative operations are sorted: so `b − a` and `−(a − b)` are the same node. Zeros, ones and
constants never become operations, and like terms meet: c₁·x + c₂·x = (c₁ + c₂)·x, a + (b − a) = b.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray

Kind = Literal[
    "constant",
    "symbol",
    "add",
    "subtract",
    "multiply",
    "sin",
    "cos",
    "sign",
    "tanh",
    "decay",
    "power",
    "inverse",
    "inverse_negated",
]
"""What a node computes; decay is exp(−x), power |x| to a constant, inverse 1/x and inverse_negated 1/(−x) of what is
positive, not a number of anything else."""


ExpressionArray = npt.NDArray[np.object_]
"""Vectors (3,) and matrices (3, 3) of expressions, which NumPy adds and multiplies entry by entry."""


@dataclass(frozen=True)
class Node:
    """One operation, or an operand."""

    kind: Kind  # which
    operands: tuple[int, ...] = ()  # numbers of the nodes that it takes, all smaller than its own
    value: float = 0.0  # of a constant, never negative
    name: str = ""  # of a symbol


@dataclass(frozen=True)
class Operations:
    """How many operations a computation takes; subtractions count as additions, changes of sign not at all."""

    multiplications: int
    additions: int
    sines: int
    others: int

    def text(self) -> str:
        """The text of a comment."""
        parts = [
            f"{self.multiplications} multiplications",
            f"{self.additions} additions",
            f"{self.sines} sines and cosines",
        ]
        if self.others:
            parts.append(f"{self.others} divisions, signs, tanh, exp or pow")
        return ", ".join(parts)


class Graph:
    """The nodes of all expressions that belong together.

    Attributes:
        nodes: each behind its operands.
    """

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._numbers: dict[tuple[Kind, tuple[int, ...], float, str], int] = {}

    def constant(self, value: float) -> Expression:
        """A number."""
        magnitude = abs(float(value))
        return Expression(self, self._number("constant", (), magnitude), value < 0.0)

    def constants(self, values: npt.ArrayLike) -> ExpressionArray:
        """An array of numbers, of the same shape."""
        numbers = np.asarray(values, dtype=np.float64)
        return np.array([self.constant(value) for value in numbers.flat], dtype=object).reshape(numbers.shape)

    def symbol(self, name: str) -> Expression:
        """An input."""
        return Expression(self, self._number("symbol", (), 0.0, name))

    def operation(self, kind: Kind, *operands: int) -> int:
        """Number of the node of an operation."""
        return self._number(kind, operands)

    def live(self, outputs: Sequence[Expression]) -> list[int]:
        """Numbers of the nodes that the outputs need, each behind its operands."""
        needed = {output.node for output in outputs}
        for number in range(len(self.nodes) - 1, -1, -1):
            if number in needed:
                needed.update(self.nodes[number].operands)
        return sorted(needed)

    def operations(self, outputs: Sequence[Expression]) -> Operations:
        """Return what computing all outputs together takes."""
        kinds = [self.nodes[number].kind for number in self.live(outputs)]
        return Operations(
            multiplications=kinds.count("multiply"),
            additions=kinds.count("add") + kinds.count("subtract"),
            sines=kinds.count("sin") + kinds.count("cos"),
            others=sum(kinds.count(kind) for kind in ("sign", "tanh", "decay", "power", "inverse", "inverse_negated")),
        )

    def evaluate(self, outputs: Sequence[Expression], inputs: Mapping[str, FloatArray]) -> FloatArray:
        """Values (outputs, N) for symbols (N,) by name."""
        count = len(next(iter(inputs.values())))
        values: dict[int, FloatArray] = {}
        for number in self.live(outputs):
            node = self.nodes[number]
            operands = [values[operand] for operand in node.operands]
            if node.kind == "constant":
                values[number] = np.full(count, node.value)
            elif node.kind == "symbol":
                values[number] = np.asarray(inputs[node.name], dtype=np.float64)
            else:
                values[number] = _NUMERIC[node.kind](*operands)
        return np.array([-values[output.node] if output.negative else values[output.node] for output in outputs])

    def _number(self, kind: Kind, operands: tuple[int, ...], value: float = 0.0, name: str = "") -> int:
        key = (kind, operands, value, name)  # most nodes are there already, and to make one takes 2 µs
        number = self._numbers.setdefault(key, len(self.nodes))
        if number == len(self.nodes):
            self.nodes.append(Node(*key))
        return number


_NUMERIC: dict[str, Callable[..., FloatArray]] = {
    "add": np.add,
    "subtract": np.subtract,
    "multiply": np.multiply,
    "sin": np.sin,
    "cos": np.cos,
    "sign": np.sign,
    "tanh": np.tanh,
    "decay": lambda value: np.exp(-value),
    "inverse": lambda value: np.divide(1.0, value, out=np.full_like(value, np.nan), where=value > 0.0),
    "inverse_negated": lambda value: np.divide(-1.0, value, out=np.full_like(value, np.nan), where=value < 0.0),
    "power": lambda value, exponent: np.abs(value) ** exponent,
}


@dataclass(frozen=True)
class Expression:
    """A node of a graph, or its negative."""

    graph: Graph = field(repr=False)
    node: int
    negative: bool = False

    @property
    def constant(self) -> float | None:
        """Return its value if it is a number."""
        node = self.graph.nodes[self.node]
        if node.kind != "constant":
            return None
        return -node.value if self.negative else node.value

    def __neg__(self) -> Expression:
        return self if self.constant == 0.0 else Expression(self.graph, self.node, not self.negative)

    def __add__(self, other: Expression | float) -> Expression:
        right = self._expression(other)
        mine, theirs = self.constant, right.constant
        if mine is not None and theirs is not None:
            return self.graph.constant(mine + theirs)
        if mine == 0.0:
            return right
        if theirs == 0.0:
            return self
        (factor, node), (other_factor, other_node) = self._coefficient(), right._coefficient()
        if node == other_node:
            return Expression(self.graph, node) * (factor + other_factor)
        for term, total in ((self, right), (right, self)):
            rest = total._without(term)
            if rest is not None:
                return rest
        first, second = sorted((self, right), key=lambda expression: expression.node)
        kind: Kind = "add" if first.negative == second.negative else "subtract"
        return Expression(self.graph, self.graph.operation(kind, first.node, second.node), first.negative)

    def __sub__(self, other: Expression | float) -> Expression:
        return self + -self._expression(other)

    def __mul__(self, other: Expression | float) -> Expression:
        right = self._expression(other)
        mine, theirs = self.constant, right.constant
        if mine is not None and theirs is not None:
            return self.graph.constant(mine * theirs)
        if mine is not None:
            return right._scaled(mine)
        if theirs is not None:
            return self._scaled(theirs)
        nodes = sorted((self.node, right.node))
        return Expression(
            self.graph, self.graph.operation("multiply", nodes[0], nodes[1]), self.negative != right.negative
        )

    def __truediv__(self, divisor: float) -> Expression:
        return self * (1.0 / divisor)

    __radd__ = __add__
    __rmul__ = __mul__

    def __rsub__(self, other: float) -> Expression:
        return -self + other

    def _expression(self, other: Expression | float) -> Expression:
        return other if isinstance(other, Expression) else self.graph.constant(other)

    def _coefficient(self) -> tuple[float, int]:
        """Factor c and node x of c·x; (±1, itself) where it is no product with a number."""
        sign = -1.0 if self.negative else 1.0
        node = self.graph.nodes[self.node]
        if node.kind == "multiply":
            for factor, other in (node.operands, node.operands[::-1]):
                if self.graph.nodes[factor].kind == "constant":
                    return sign * self.graph.nodes[factor].value, other
        return sign, self.node

    def _scaled(self, factor: float) -> Expression:
        own, node = self._coefficient()
        total = own * factor
        if total == 0.0:
            return self.graph.constant(0.0)
        if abs(total) == 1.0:
            return Expression(self.graph, node, total < 0.0)
        number = self.graph.constant(abs(total)).node
        return Expression(
            self.graph, self.graph.operation("multiply", min(number, node), max(number, node)), total < 0.0
        )

    def _without(self, term: Expression) -> Expression | None:
        """Return what is left of this sum where −`term` is one of its two parts."""
        node = self.graph.nodes[self.node]
        if node.kind not in ("add", "subtract"):
            return None
        left = Expression(self.graph, node.operands[0], self.negative)
        right = Expression(self.graph, node.operands[1], self.negative != (node.kind == "subtract"))
        for factor, rest in ((left, right), (right, left)):
            if factor.node == term.node and factor.negative != term.negative:
                return rest
        return None


def sine(angle: Expression) -> Expression:
    """Sine, odd."""
    return _odd("sin", angle, math.sin)


def cosine(angle: Expression) -> Expression:
    """Cosine, even."""
    if angle.constant is not None:
        return angle.graph.constant(math.cos(angle.constant))
    return Expression(angle.graph, angle.graph.operation("cos", angle.node))


def sign(value: Expression) -> Expression:
    """Sign: 1, 0 or −1."""
    return _odd("sign", value, lambda number: float(np.sign(number)))


def hyperbolic_tangent(value: Expression) -> Expression:
    """Hyperbolic tangent, odd."""
    return _odd("tanh", value, math.tanh)


def decay(value: Expression) -> Expression:
    """exp(−x) of a square or another expression without a sign."""
    if value.negative:
        raise ValueError("the expression has a sign")
    return Expression(value.graph, value.graph.operation("decay", value.node))


def power(value: Expression, exponent: float) -> Expression:
    """|x| to a positive constant."""
    if exponent == 2.0:
        return value * value
    return Expression(value.graph, value.graph.operation("power", value.node, value.graph.constant(exponent).node))


def inverse(value: Expression) -> Expression:
    """1/x of a positive x; of any other not a number."""
    if value.constant is not None and value.constant > 0.0:
        return value.graph.constant(1.0 / value.constant)
    kind: Kind = "inverse_negated" if value.negative else "inverse"
    return Expression(value.graph, value.graph.operation(kind, value.node))


def _odd(kind: Kind, value: Expression, of_number: Callable[[float], float]) -> Expression:
    if value.constant is not None:
        return value.graph.constant(of_number(value.constant))
    return Expression(value.graph, value.graph.operation(kind, value.node), value.negative)


def solved(matrix: Sequence[Sequence[Expression]], right: Sequence[Expression]) -> tuple[Expression, ...]:
    """X (n,) of M·x = b; not a number where M is not positive definite."""
    count = len(right)
    pivots: list[Expression] = []
    lower: list[list[Expression]] = []  # of L without its diagonal
    for row in range(count):
        scaled: list[Expression] = []  # of L·D
        for column in range(row):
            entry = matrix[row][column]
            for k in range(column):
                entry = entry - scaled[k] * lower[column][k]
            scaled.append(entry)
        lower.append([entry * pivot for entry, pivot in zip(scaled, pivots, strict=True)])
        left = matrix[row][row]
        for entry, share in zip(scaled, lower[row], strict=True):
            left = left - entry * share
        pivots.append(inverse(left))
    forward: list[Expression] = []
    for row in range(count):
        value = right[row]
        for k in range(row):
            value = value - lower[row][k] * forward[k]
        forward.append(value)
    solution = [value * pivot for value, pivot in zip(forward, pivots, strict=True)]
    for row in range(count - 1, -1, -1):
        for k in range(row + 1, count):
            solution[row] = solution[row] - lower[k][row] * solution[k]
    return tuple(solution)
