"""Draws the rooms of the house and their arrows in studies/house.md, from the imports: `make house`."""

from __future__ import annotations

import ast
import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

PACKAGES = ("drivers", "daq", "ident", "sim_drivers", "dynid")
PAGE = Path("studies/house.md")

WALK = (
    ("drivers/gains.py", "joint_torque", "current [A] becomes joint torque [N·m], by gain and coupling"),
    ("daq/recording/recorder.py", "Recorder", "samples are written while they arrive, never filtered"),
    ("daq/recording/reader.py", "read_recording", "returns the `Recording`: streams of channels, as stored"),
    ("ident/signals/joint_signals.py", "read_joint_signals", "torques in the robot's order, and their origin"),
    ("ident/signals/pipeline.py", "prepare", "returns `Prepared`: uniform segments of q, q̇, q̈ and τ"),
    ("ident/model/regressor.py", "RegressorKernel", "Y(q, q̇, q̈) of the base columns, chunk by chunk"),
    ("ident/regression/observation_matrix.py", "reduce_segments", "returns the `Reduction` of Y = W·X + ρ"),
    ("ident/regression/least_squares.py", "solve_weighted", "returns `LeastSquares`: the base parameters"),
    ("ident/regression/jackknife.py", "block_jackknife", "their covariance, as residuals are autocorrelated"),
    ("ident/identify/identify.py", "identify", "calls all of these in order; returns the `Identification`"),
    ("ident/identify/held_out.py", "held_out_run", "the delivered model on held-out data; `model_verdict` grades it"),
    ("ident/identify/summary.py", "Identified", "has the `Result`, which is result.json"),
)  # fmt: skip
"""File, name in it, what it does: from a motor's current to the fit."""


def sources() -> dict[str, str]:
    """Module → source, of the working tree."""
    files = [path for package in PACKAGES for path in sorted(Path(package).rglob("*.py"))]
    return {
        str(path).removesuffix(".py").removesuffix("/__init__").replace("/", "."): path.read_text() for path in files
    }


def imported(text: str) -> Iterator[str]:
    """Modules that a module imports, those for type checkers left out."""
    for node in ast.walk(_running(ast.parse(text))):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{name.name}" for name in node.names)
        elif isinstance(node, ast.Import):
            yield from (name.name for name in node.names)


def _running(tree: ast.Module) -> ast.Module:
    tree.body = [
        node for node in tree.body if not (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test))
    ]
    return tree


def room_of(module: str) -> str:
    """The room of a module: `ident.signals` of `ident.signals.filters`."""
    return ".".join(module.split(".")[:2])


def rooms(modules: dict[str, str]) -> tuple[dict[str, tuple[int, int]], set[tuple[str, str]]]:
    """Room → its modules and lines; and the arrows that do not follow from others."""
    sizes: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    arrows: set[tuple[str, str]] = set()
    ignored = {
        tuple(pair.split(" -> "))
        for contract in tomllib.loads(Path("pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
        for pair in contract.get("ignore_imports", ())
    }
    for module, text in modules.items():
        room = room_of(module)
        sizes[room][0] += 1
        sizes[room][1] += text.count("\n")
        for name in imported(text):
            target = name if name in modules else name.rpartition(".")[0]
            if target in modules and (module, target) not in ignored and room_of(target) != room:
                arrows.add((room, room_of(target)))
    drawn = {room: (count, lines) for room, (count, lines) in sizes.items() if "." in room and lines > 1}
    return drawn, {(start, end) for start, end in arrows if start in drawn and end in drawn}


def direct(arrows: set[tuple[str, str]]) -> set[tuple[str, str]]:
    """The arrows that no longer way replaces."""
    after: dict[str, set[str]] = defaultdict(set)
    for start, end in arrows:
        after[start].add(end)

    def reached(start: str, seen: set[str]) -> set[str]:
        for end in after[start] - seen:
            seen.add(end)
            reached(end, seen)
        return seen

    return {
        (start, end) for start, end in arrows if not any(end in reached(other, set()) for other in after[start] - {end})
    }


def picture(modules: dict[str, str]) -> str:
    """The house as Mermaid: a box per package, a node per room with its modules and lines."""
    sizes, arrows = rooms(modules)
    lines = ["```mermaid", "flowchart LR"]
    for package in PACKAGES[:-1]:
        inside = [room for room in sorted(sizes) if room.startswith(f"{package}.")]
        total = sum(text.count("\n") for module, text in modules.items() if module.split(".")[0] == package)
        lines.append(f'  subgraph {package}["{package}/ {total:,} lines"]')
        for room in inside:
            count, size = sizes[room]
            of = f"{count} modules, " if count > 1 else ""
            lines.append(f'    {room.replace(".", "_")}["{room.split(".")[1]}<br>{of}{size:,} lines"]')
        own = {pair for pair in arrows if all(room in inside for room in pair)}
        lines += [f"    {start.replace('.', '_')} --> {end.replace('.', '_')}" for start, end in sorted(direct(own))]
        lines.append("  end")
    lines += [f"  {right} ==> {left}" for left, right in pairwise(PACKAGES[:-1])]
    return "\n".join([*lines, "```"])


def count_of(modules: dict[str, str]) -> str:
    """How large a house is, in words."""
    return f"{sum(len(text.splitlines()) for text in modules.values()):,} lines in {len(modules)} modules"


def walk() -> str:
    """The table of the walk from current to fit.

    Raises:
        SystemExit: a step is no longer there.
    """
    rows = ["| room | name | what it does |", "|---|---|---|"]
    for file, name, meaning in WALK:
        tree = ast.parse(Path(file).read_text())
        names = {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
        if name not in names:
            raise SystemExit(f"{file} has no {name}: {', '.join(sorted(names))}")
        rows.append(f"| `{file}` | `{name}` | {meaning} |")
    return "\n".join(rows)


def main() -> None:
    """Write the page."""
    modules = sources()
    page = f"""# The house

Drawn from the imports by `make house`: {count_of(modules)}. An arrow goes from a room to one that it imports; arrows
that follow from longer paths are left out. Thick arrows are between packages: each imports those to its left.

{picture(modules)}

## From current to fit

{walk()}
"""
    PAGE.write_text(page)
    print(f"{PAGE}: {count_of(modules)}", file=sys.stderr)


if __name__ == "__main__":
    main()
