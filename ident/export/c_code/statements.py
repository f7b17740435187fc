"""C statements of expressions: temporaries for what is used more than once or would make a line too long."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Literal

import numpy as np

from drivers.core.errors import ModelError
from ident.export.c_code.expressions import Expression, Graph
from ident.export.c_code.functions import Function

Real = Literal["double", "float"]

LONGEST_INLINE = 80
"""Characters of an expression that still stands inside another one."""


@dataclass(frozen=True)
class Dialect:
    """How numbers are written."""

    real: Real  # C type of the arithmetic
    type_name: str  # of the arm's numbers
    sign: str  # name of the function for signs
    inverse: str  # name of the function for 1/x of a positive x

    def number(self, value: float) -> str:
        """A floating constant.

        Raises:
            ModelError: the type cannot hold it.
        """
        rounded = float(np.float32(value)) if self.real == "float" and abs(value) < 1e39 else float(value)
        if not np.isfinite(rounded) or (self.real == "float" and abs(rounded) > float(np.finfo(np.float32).max)):
            raise ModelError(f"a constant of the model, {value:.3g}, does not fit into a C {self.real}")
        if self.real == "double":
            return repr(rounded)
        text = np.format_float_scientific(np.float32(rounded), unique=True, trim="0") if rounded else "0.0"
        plain = np.format_float_positional(np.float32(rounded), unique=True, trim="0")
        return f"{plain if len(plain) <= len(text) else text}f"

    def function(self, kind: str) -> str:
        """Name of sin, cos, tanh, exp, pow, fabs, sign or inverse."""
        if kind in ("sign", "inverse"):
            return self.sign if kind == "sign" else self.inverse
        return f"{kind}f" if self.real == "float" else kind


@dataclass(frozen=True)
class _Text:
    """An expression's text, and how tightly its last operation binds: 0 atom, 1 product, 2 sum."""

    text: str
    looseness: int


def statements(graph: Graph, function: Function, joints: int, dialect: Dialect) -> list[str]:
    """The body of a function: inputs read, temporaries, outputs written, a line each.

    Inputs are read before anything is written, so that arrays may overlap.
    """
    outputs = function.outputs
    live = graph.live(outputs)
    uses = Counter(operand for number in live for operand in graph.nodes[number].operands)
    uses.update(output.node for output in outputs)
    names = {
        f"{array}{joint}": f"{array}[{joint}]"
        for array in function.inputs
        for joint in range(function.sizes.get(array, joints))
    }
    lines, used = [], {graph.nodes[number].name for number in live}
    for array in function.inputs:
        read = [name for name in names if name.rstrip("0123456789") == array and name in used]
        lines += [f"const {dialect.type_name} {name} = {names[name]};" for name in read]
        if not read:
            lines.append(f"(void){array};")
    texts: dict[int, _Text] = {}
    counts: Counter[str] = Counter()
    for number in live:
        node = graph.nodes[number]
        text = _text(graph, number, texts, dialect)
        atom = node.kind in ("constant", "symbol")
        if not atom and (uses[number] > 1 or len(text.text) > LONGEST_INLINE or node.kind in ("sin", "cos")):
            letter = {"sin": "s", "cos": "c"}.get(node.kind, "t")
            counts[letter] += 1
            name = f"{letter}{counts[letter]}"
            lines.append(f"const {dialect.type_name} {name} = {text.text};")
            text = _Text(name, 0)
        texts[number] = text
    for i, row in enumerate(function.rows):
        for j, entry in enumerate(row):
            place = f"[{i}][{j}]" if function.matrix else f"[{j}]"
            lines.append(f"{function.output}{place} = {_output(graph, entry, texts)};")
    return lines


def _text(graph: Graph, number: int, texts: dict[int, _Text], dialect: Dialect) -> _Text:
    node = graph.nodes[number]
    operands = [texts[operand] for operand in node.operands]
    if node.kind == "constant":
        return _Text(dialect.number(node.value), 0)
    if node.kind == "symbol":
        return _Text(node.name, 0)
    if node.kind == "multiply":
        left, right = operands
        return _Text(f"{_bound(left, 1)} * {_bound(right, 0)}", 1)
    if node.kind in ("add", "subtract"):
        left, right = operands
        return _Text(f"{left.text} {'+' if node.kind == 'add' else '-'} {_bound(right, 1)}", 2)
    if node.kind == "decay":
        return _Text(f"{dialect.function('exp')}(-{_bound(operands[0], 0)})", 0)
    if node.kind == "inverse_negated":
        return _Text(f"{dialect.inverse}(-{_bound(operands[0], 0)})", 0)
    if node.kind == "power":
        base = f"{dialect.function('fabs')}({operands[0].text})"
        return _Text(f"{dialect.function('pow')}({base}, {operands[1].text})", 0)
    return _Text(f"{dialect.function(node.kind)}({operands[0].text})", 0)


def _bound(text: _Text, looseness: int) -> str:
    """The text, in parentheses where it binds less tightly; they also keep the order of the operations."""
    return text.text if text.looseness <= looseness else f"({text.text})"


def _output(graph: Graph, entry: Expression, texts: dict[int, _Text]) -> str:
    text = texts[entry.node]
    if not entry.negative:
        return text.text
    node = graph.nodes[entry.node]
    if node.kind == "subtract" and text.looseness == 2:
        left, right = (texts[operand] for operand in node.operands)
        return f"{right.text} - {_bound(left, 1)}"
    return f"-{_bound(text, 0)}"
