"""Write the C code of an identified arm."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from os import PathLike

from daq.output_files import check_outputs, replace_files
from drivers.core.files import path_of
from ident.export.c_code.expressions import Graph
from ident.export.c_code.functions import arm_functions, left_out
from ident.export.c_code.names import identifier, source_paths
from ident.export.c_code.reference import check_expressions, reference
from ident.export.c_code.source import GENERATION, Description, Parameter, header, source
from ident.export.c_code.statements import Dialect, Real
from ident.export.export import Export
from ident.model.dynamics.inverse_dynamics import InverseDynamics


def write_c(
    dynamics: InverseDynamics,
    path: str | PathLike[str],
    *,
    real: Real = "double",
    kind: str = "base parameters",
    origin: Sequence[str] = (),
    parameters: Sequence[Parameter] | None = None,
    names: Sequence[str] | None = None,
    overwrite: bool = False,
) -> Export:
    """Write a C99 header and source: an arm's inverse and forward dynamics, their terms, payload and regressor.

    Args:
        dynamics: of the identified parameters.
        path: of both files, without suffix: `arm` for arm.h and arm.c.
        real: type of the arithmetic.
        kind: which parameters these are, for a comment.
        origin: lines on where they come from, for the header.
        parameters: (b,) the base parameters with their deviations; without these where None.
        names: of the functions that the parameters allow; all where None.
        overwrite: replace what exists.

    Raises:
        UsageError: a file exists, cannot be written, or has a name that C cannot include.
        ModelError: loops of the arm are solved numerically, or its parameters do not fit into the type.
    """
    header_path, source_path = source_paths(path_of(path))
    check_outputs([header_path, source_path], overwrite=overwrite)
    graph = Graph()
    functions = tuple(
        function for function in arm_functions(graph, dynamics) if names is None or function.name in names
    )
    check_expressions(graph, functions, dynamics)
    prefix = identifier(dynamics.model.name)
    dialect = Dialect(real, f"{prefix}_real", f"{prefix}_sign", f"{prefix}_inverse")
    model = dynamics.model
    refused = left_out(dynamics) if names is None else {}
    lacking = tuple(f"{name}: {reason}" for name, reason in refused.items())
    plain = [
        Parameter(name, float(value)) for name, value in zip(dynamics.base.names, dynamics.parameters, strict=True)
    ]
    description = Description(
        robot=model.name,
        prefix=prefix,
        joints=tuple(
            f"{model.joints[index].name}{' (prismatic)' if model.joints[index].prismatic else ''}"
            for index in model.active
        ),
        parameters=tuple(plain if parameters is None else parameters),
        kind=kind,
        origin=tuple(origin),
        left_out=lacking,
        tool=model.joints[model.tool_link].name,
    )
    declared = header(description, functions, dialect)
    defined = source(graph, description, functions, dialect, reference(dynamics, real), header_path.name)
    texts = {header_path: declared, source_path: defined}
    generation = hashlib.sha256("".join(texts.values()).encode()).hexdigest()[:15]  # a signed number
    replace_files({path: text.replace(GENERATION, generation) for path, text in texts.items()})
    first = functions[0]
    return Export(
        path=source_path,
        format=f"C99 in {real}, {kind}; header {header_path.name}; {first.name}: "
        f"{graph.operations(first.outputs).text()}",
        left_out=lacking,
        readings=(),
        checks=(),
    )
