"""The public benchmark on one registered data set, as Markdown: where dynid loses first, then every entry.

    python -m studies.methods.public_benchmark DATASET [METHODS, separated by commas]

The folder of the recordings is DYNID_DATA. Minutes to a quarter of an hour of CPU time.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from ident.benchmark.dataset import chosen_datasets
from ident.benchmark.entry import chosen_methods
from ident.benchmark.run import run_benchmark
from ident.result.tables import Table


def markdown(table: Table) -> str:
    """A table's rows with their headings."""
    rows = [[column.heading for column in table.columns], ["---"] * len(table.columns)]
    rows += [list(cells) for cells in zip(*(column.texts for column in table.columns), strict=True)]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def main() -> None:
    """Print the tables."""
    name, *methods = sys.argv[1:]
    folder = Path(os.environ.get("DYNID_DATA", "../shared/data"))
    entries = chosen_methods(tuple(methods[0].split(",")) if methods else ())
    benchmark = run_benchmark(
        chosen_datasets([name]), entries, folder, progress=lambda step: print(step, file=sys.stderr)
    )
    nothing = "dynid loses nowhere." if benchmark.judges_ours else "dynid is not among the entries."
    print(markdown(benchmark.losses) if len(benchmark.losses) else nothing)
    print()
    print(markdown(benchmark.tables[0]))
    print("\n".join(("", *benchmark.failures)))


if __name__ == "__main__":
    main()
