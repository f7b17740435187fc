"""Options that several commands share."""

from __future__ import annotations

import typer

FORCE = typer.Option(False, "--force", help="Overwrite files that exist.")
JSON = typer.Option(False, "--json", help="One JSON object on standard output, nothing else there.")
