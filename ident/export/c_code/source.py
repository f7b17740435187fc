"""The text of the C header and source of an arm."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.export.c_code.expressions import Graph
from ident.export.c_code.functions import Function
from ident.export.c_code.names import comment_text
from ident.export.c_code.reference import TOLERANCES, ExpectedValues
from ident.export.c_code.statements import Dialect, statements

WIDTH = 120
"""Characters of a line."""


@dataclass(frozen=True)
class Parameter:
    """One base parameter."""

    name: str  # as in the report
    value: float  # in its unit
    std: float | None = None  # its standard deviation; None where it is not known
    unit: str = ""  # of both
    expression: str = ""  # what it combines

    @property
    def text(self) -> str:
        """A parameter in a comment: name, unit, σ, expression."""
        std = "unknown" if self.std is None else f"{self.std:.3g}"
        combined = f"; {self.expression}" if self.expression not in ("", self.name) else ""
        return f"{self.name} [{self.unit}] std {std}{combined}"


@dataclass(frozen=True)
class Description:
    """What the comments and declarations say."""

    robot: str  # its name
    prefix: str  # of all C names
    joints: tuple[str, ...]  # names (n,), prismatic ones marked
    parameters: tuple[Parameter, ...]  # of the base
    kind: str  # which parameters these are
    origin: tuple[str, ...]  # lines on where they come from
    left_out: tuple[str, ...]  # lines on functions that are not there
    tool: str  # name of the joint whose frame the payload is given in


PRESLIDING = (
    "Presliding: keep z from sample to sample, presliding_state(z, dq, step, z), and add presliding_torque to torque; "
    "without them dry friction changes with the sign of dq."
)

GENERATION = "@generation@"
"""Stands in both texts for what the files of one export have in common, and others have not."""


def header(description: Description, functions: Sequence[Function], dialect: Dialect) -> str:
    """Text of the .h file."""
    prefix, macro = description.prefix, description.prefix.upper()
    order = "\n".join(f" *   {index}  {comment_text(name)}" for index, name in enumerate(description.joints))
    declarations = "\n\n".join(
        f"/* {function.summary} */\n{_signature(function, prefix, len(description.joints))};" for function in functions
    )
    friction = next((", ".join(function.inputs) for function in functions if function.name == "friction"), "dq")
    origin = _lines(("", *description.origin)) if description.origin else ""
    lacking = (
        _lines(("", "Not there:", *(f"  {line}" for line in description.left_out))) if description.left_out else ""
    )
    whole = any(function.name == "torque" for function in functions)
    sliding = _lines((PRESLIDING,)) if any(function.name == "presliding_state" for function in functions) else ""
    equation = f"tau = M(q) ddq + C(q, dq) dq + g(q) + friction({friction})" if whole else "tau = g(q)"
    return f"""\
/* Dynamic model of {comment_text(description.robot)}, written by dynid; it holds {comment_text(description.kind)}.
 *
 *     {equation}
 *
 * at the joints with a motor, in this order:
 *
{order}
{origin} *
 * Units: rad, rad/s, rad/s^2, N m; of prismatic joints m, m/s, m/s^2, N. C99, straight-line code: no allocation, no
 * state of its own, no loop. The arrays of a call may overlap. cc -D{macro}_SELF_TEST makes a program that tests it.
 * A payload is its mass, its centre of mass x y z and its inertia xx xy xz yy yz zz about that centre [kg, m, kg m^2],
 * in the frame of joint {comment_text(description.tool)}; add payload_torque to torque.
{sliding}{lacking} */
#ifndef {macro}_H
#define {macro}_H

#ifdef __cplusplus
extern "C" {{
#endif

/* Of this pair of files: the source does not compile with the header of another one. */
#define {macro}_GENERATION 0x{GENERATION}
#define {macro}_JOINTS {len(description.joints)}
#define {macro}_PARAMETERS {len(description.parameters)}

typedef {dialect.real} {dialect.type_name};

{declarations}

/* The base parameters that the code holds, in the order of the regressor's columns, and their standard deviations
 * (negative where they are not known). */
extern const {dialect.type_name} {prefix}_parameters[{macro}_PARAMETERS];
extern const {dialect.type_name} {prefix}_parameters_std[{macro}_PARAMETERS];

#ifdef __cplusplus
}}
#endif

#endif
"""


def source(
    graph: Graph,
    description: Description,
    functions: Sequence[Function],
    dialect: Dialect,
    expected: ExpectedValues,
    header_name: str,
) -> str:
    """Text of the .c file."""
    prefix, macro = description.prefix, description.prefix.upper()
    kinds = {graph.nodes[number].kind for function in functions for number in graph.live(function.outputs)}
    parts = [
        f"/* Dynamic model of {comment_text(description.robot)}, written by dynid; what it means stands in "
        f"{header_name}.\n"
        f" * Test: cc -std=c99 -D{macro}_SELF_TEST {header_name[:-2]}.c -lm && ./a.out (deviations up to "
        f"{TOLERANCES[dialect.real]:g} of the largest value pass). */",
        f'#include "{header_name}"\n\n#include <math.h>',
        f"#if {macro}_GENERATION != 0x{GENERATION}\n"
        f'#error "{header_name} and {header_name[:-2]}.c were not written together: export them again"\n#endif',
        _parameter_table(description, dialect),
        _deviation_table(description, dialect),
    ]
    if kinds & {"inverse", "inverse_negated"}:
        unity = dialect.number(1.0)
        parts.append(
            f"/* 1/x of what a positive definite matrix leaves positive; not a number where it is none. */\n"
            f"static {dialect.type_name} {dialect.inverse}({dialect.type_name} x)\n"
            f"{{\n    return x > 0 ? {unity} / x : ({dialect.type_name})NAN;\n}}"
        )
    if "sign" in kinds:
        parts.append(
            f"static {dialect.type_name} {dialect.sign}({dialect.type_name} x)\n"
            f"{{\n    return ({dialect.type_name})((x > 0) - (x < 0));\n}}"
        )
    for function in functions:
        body = "\n".join(f"    {line}" for line in statements(graph, function, len(description.joints), dialect))
        parts.append(
            f"/* {graph.operations(function.outputs).text()} */\n"
            f"{_signature(function, prefix, len(description.joints))}\n{{\n{body}\n}}"
        )
    parts.append(self_test(functions, expected, prefix, dialect))
    return "\n\n".join(parts)


def _signature(function: Function, prefix: str, joints: int) -> str:
    macro, real = prefix.upper(), f"{prefix}_real"
    inputs = [f"const {real} {name}[{function.sizes.get(name, f'{macro}_JOINTS')}]" for name in function.inputs]
    columns = ""
    if function.matrix:
        columns = f"[{macro}_JOINTS]" if len(function.rows[0]) == joints else f"[{macro}_PARAMETERS]"
    rows = f"{macro}_JOINTS" if function.matrix or len(function.rows[0]) == joints else len(function.rows[0])
    arguments = [*inputs, f"{real} {function.output}[{rows}]{columns}"]
    opening = f"void {prefix}_{function.name}("
    one_line = f"{opening}{', '.join(arguments)})"
    return one_line if len(one_line) < WIDTH else opening + (",\n" + " " * len(opening)).join(arguments) + ")"


def _parameter_table(description: Description, dialect: Dialect) -> str:
    rows = [
        f"    {dialect.number(parameter.value)}, /* {index} {comment_text(parameter.text)} */"
        for index, parameter in enumerate(description.parameters)
    ]
    opening = f"const {dialect.type_name} {description.prefix}_parameters[{description.prefix.upper()}_PARAMETERS] = {{"
    return "\n".join([opening, *rows, "};"])


def _deviation_table(description: Description, dialect: Dialect) -> str:
    rows = [
        f"    {dialect.number(-1.0 if parameter.std is None else parameter.std)}, /* {comment_text(parameter.name)} */"
        for parameter in description.parameters
    ]
    count = f"{description.prefix.upper()}_PARAMETERS"
    return "\n".join([f"const {dialect.type_name} {description.prefix}_parameters_std[{count}] = {{", *rows, "};"])


def _lines(texts: Sequence[str]) -> str:
    """Lines of the header's comment, wrapped."""
    lines: list[str] = []
    for text in texts:
        indent = " " * (len(text) - len(text.lstrip()))
        lines += textwrap.wrap(
            comment_text(text), WIDTH - 8, initial_indent=indent, subsequent_indent=f"{indent}  "
        ) or [""]
    return "".join(f" * {line}".rstrip() + "\n" for line in lines)


_COMPARE = """\
/* Prints the largest deviation of values from expected, relative to scale; 1 where it is beyond the tolerance. */
static int beyond(const char *name, const double *values, const double *expected, int count, double scale)
{
    double largest = 0.0;
    for (int i = 0; i < count; i++) {
        const double deviation = fabs(values[i] - expected[i]) / scale;
        if (!(deviation <= largest)) {
            largest = deviation;
        }
        if (deviation != deviation) {
            break; /* not a number */
        }
    }
    printf("%-16s %.1e\\n", name, largest);
    return !(largest <= TOLERANCE);
}
"""


def self_test(functions: Sequence[Function], expected: ExpectedValues, prefix: str, dialect: Dialect) -> str:
    """C source behind `#ifdef PREFIX_SELF_TEST`."""
    macro, count = prefix.upper(), len(expected.inputs["q"])
    arrays = sorted({name for function in functions for name in function.inputs}, key=list(expected.inputs).index)
    parts = [
        f"#ifdef {macro}_SELF_TEST\n#include <stdio.h>\n",
        f"#define STATES {count}\n#define TOLERANCE {TOLERANCES[dialect.real]!r}\n",
    ]
    for name in arrays:
        parts.append(
            f"static const {dialect.type_name} input_{name}[STATES][{len(expected.inputs[name][0])}] = "
            f"{{\n{_table(expected.inputs[name], dialect)}}};\n"
        )
    in_double = Dialect("double", "double", "", "")
    bodies = ["    int failed = 0;"]
    for function in functions:
        values = expected.outputs[function.name]
        if function.matrix and function.name == "regressor":
            values = values[:1]  # of one state; the others are compared through the torque
        flat = values.reshape(len(values), -1)
        size = flat.shape[1]
        parts.append(
            f"static const double expected_{function.name}[{len(flat)}][{size}] = {{\n{_table(flat, in_double)}}};\n"
        )
        bodies += _compared(function, prefix, size, len(flat), expected.scales[function.name], dialect)
    if {"torque", "regressor"} <= {function.name for function in functions}:
        bodies += _regressed(prefix, expected.scales["torque"], dialect)
    bodies.append(f'    puts(failed ? "{prefix}: FAILED" : "{prefix}: passed");')
    bodies.append("    return failed;")
    main = "int main(void)\n{\n" + "\n".join(bodies) + "\n}\n#endif\n"
    return "\n".join([*parts, _COMPARE, main])


def _compared(function: Function, prefix: str, size: int, states: int, scale: float, dialect: Dialect) -> list[str]:
    """One function against its expected values, in a block of `main`."""
    shape = f"[{len(function.rows)}][{len(function.rows[0])}]" if function.matrix else f"[{size}]"
    arguments = ", ".join(f"input_{name}[state]" for name in function.inputs)
    source = "output[i / {0}][i % {0}]".format(len(function.rows[0])) if function.matrix else "output[i]"
    return [
        "    {",
        f"        static double values[{states}][{size}];",
        f"        for (int state = 0; state < {states}; state++) {{",
        f"            {dialect.type_name} output{shape};",
        f"            {prefix}_{function.name}({arguments}, output);",
        f"            for (int i = 0; i < {size}; i++) {{",
        f"                values[state][i] = {source};",
        "            }",
        "        }",
        f'        failed |= beyond("{function.name}", values[0], expected_{function.name}[0], {states * size}, '
        f"{scale!r});",
        "    }",
    ]


def _regressed(prefix: str, scale: float, dialect: Dialect) -> list[str]:
    """The regressor times the parameters against the expected torque."""
    macro = prefix.upper()
    return [
        "    {",
        f"        static double values[STATES][{macro}_JOINTS];",
        "        for (int state = 0; state < STATES; state++) {",
        f"            static {dialect.type_name} output[{macro}_JOINTS][{macro}_PARAMETERS];",
        f"            {prefix}_regressor(input_q[state], input_dq[state], input_ddq[state], output);",
        f"            for (int i = 0; i < {macro}_JOINTS; i++) {{",
        "                values[state][i] = 0.0;",
        f"                for (int j = 0; j < {macro}_PARAMETERS; j++) {{",
        f"                    values[state][i] += (double)output[i][j] * (double){prefix}_parameters[j];",
        "                }",
        "            }",
        "        }",
        f'        failed |= beyond("Y*parameters", values[0], expected_torque[0], STATES * {macro}_JOINTS, {scale!r});',
        "    }",
    ]


def _table(values: FloatArray, dialect: Dialect) -> str:
    """Rows of an initialiser."""
    rows = [
        textwrap.fill(
            "{" + ", ".join(dialect.number(float(value)) for value in row) + "},",
            width=110,
            initial_indent="    ",
            subsequent_indent="     ",
            break_long_words=False,
            break_on_hyphens=False,
        )
        for row in np.atleast_2d(values)
    ]
    return "\n".join(rows) + "\n"
