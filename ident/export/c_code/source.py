"""The text of the C header and source of an arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ident.export.c_code.expressions import Graph
from ident.export.c_code.functions import Function
from ident.export.c_code.names import comment_text
from ident.export.c_code.reference import TOLERANCES, Reference
from ident.export.c_code.self_test import self_test
from ident.export.c_code.statements import Dialect, statements

WIDTH = 120
"""Characters of a line."""


@dataclass(frozen=True)
class Description:
    """What the comments and declarations say.

    Attributes:
        robot: its name.
        prefix: of all C names.
        joints: names (n,), prismatic ones marked.
        parameters: (name, value) of the base parameters.
        kind: which parameters these are.
    """

    robot: str
    prefix: str
    joints: tuple[str, ...]
    parameters: tuple[tuple[str, float], ...]
    kind: str


def header(description: Description, functions: Sequence[Function], dialect: Dialect) -> str:
    """Text of the .h file."""
    prefix, macro = description.prefix, description.prefix.upper()
    order = "\n".join(f" *   {index}  {comment_text(name)}" for index, name in enumerate(description.joints))
    declarations = "\n\n".join(
        f"/* {function.summary} */\n{_signature(function, prefix, len(description.joints))};" for function in functions
    )
    return f"""\
/* Dynamic model of {comment_text(description.robot)}, written by dynid; it holds {comment_text(description.kind)}.
 *
 *     tau = M(q) ddq + C(q, dq) dq + g(q) + friction(dq)
 *
 * at the joints with a motor, in this order:
 *
{order}
 *
 * Units: rad, rad/s, rad/s^2, N m; of prismatic joints m, m/s, m/s^2, N. C99, straight-line code: no allocation, no
 * state, no loop. The arrays of a call may overlap. cc -D{macro}_SELF_TEST makes a program that tests the code.
 */
#ifndef {macro}_H
#define {macro}_H

#ifdef __cplusplus
extern "C" {{
#endif

#define {macro}_JOINTS {len(description.joints)}
#define {macro}_PARAMETERS {len(description.parameters)}

typedef {dialect.real} {dialect.type_name};

{declarations}

/* The base parameters that the code holds, in the order of the regressor's columns. */
extern const {dialect.type_name} {prefix}_parameters[{macro}_PARAMETERS];

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
    expected: Reference,
    header_name: str,
) -> str:
    """Text of the .c file."""
    prefix, macro = description.prefix, description.prefix.upper()
    signs = any(graph.nodes[number].kind == "sign" for function in functions for number in graph.live(function.outputs))
    parts = [
        f"/* Dynamic model of {comment_text(description.robot)}, written by dynid; what it means stands in "
        f"{header_name}.\n"
        f" * Test: cc -std=c99 -D{macro}_SELF_TEST {header_name[:-2]}.c -lm && ./a.out (deviations up to "
        f"{TOLERANCES[dialect.real]:g} of the largest value pass). */",
        f'#include "{header_name}"\n\n#include <math.h>',
        _parameter_table(description, dialect),
    ]
    if signs:
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
    inputs = [f"const {real} {name}[{macro}_JOINTS]" for name in function.inputs]
    columns = ""
    if function.matrix:
        columns = f"[{macro}_JOINTS]" if len(function.rows[0]) == joints else f"[{macro}_PARAMETERS]"
    arguments = [*inputs, f"{real} {function.output}[{macro}_JOINTS]{columns}"]
    opening = f"void {prefix}_{function.name}("
    one_line = f"{opening}{', '.join(arguments)})"
    return one_line if len(one_line) < WIDTH else opening + (",\n" + " " * len(opening)).join(arguments) + ")"


def _parameter_table(description: Description, dialect: Dialect) -> str:
    rows = [
        f"    {dialect.number(value)}, /* {index} {comment_text(name)} */"
        for index, (name, value) in enumerate(description.parameters)
    ]
    opening = f"const {dialect.type_name} {description.prefix}_parameters[{description.prefix.upper()}_PARAMETERS] = {{"
    return "\n".join([opening, *rows, "};"])
