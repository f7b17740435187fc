"""The self-test at the end of the C code: reference vectors, and a main that compares."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np

from drivers.core.arrays import FloatArray
from ident.export.c_code.functions import Function
from ident.export.c_code.reference import TOLERANCES, ReferenceValues
from ident.export.c_code.statements import Dialect

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


def self_test(functions: Sequence[Function], expected: ReferenceValues, prefix: str, dialect: Dialect) -> str:
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
