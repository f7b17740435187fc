"""The command `dynid friction`."""

from __future__ import annotations

from pathlib import Path

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, folder_option, takes
from ident.tasks.options import FrictionOptions

app = CommandApp("Identify")


@app.command("friction")
@takes(FrictionOptions)
def find_friction(
    *, options: FrictionOptions, out: Path = folder_option("friction.json"), force: bool = FORCE, as_json: bool = JSON
) -> None:
    """Identify joint friction over speed, temperature and load.

    Example: dynid friction cold.h5 warm.h5 warmer.h5 -o friction
    """
    from ident.commands.printing.result import print_tables
    from ident.commands.saving import check_result_folder, print_files, save_result
    from ident.result.friction_experiment import FRICTION_FILE
    from ident.tasks.arguments import paths_of
    from ident.tasks.experiments import friction
    from ident.views.friction_tables import COEFFICIENTS

    folder = out if out is not None else Path(f"{paths_of(options.runs)[0].stem}-friction")
    check_result_folder(folder, FRICTION_FILE, [options.runs], options.robot, overwrite=force)
    identified = save_result(
        lambda progress: friction(**{**vars(options), "progress": progress}), folder, overwrite=force, as_json=as_json
    )
    if as_json:
        print(identified.to_json())
        return
    result = identified.result
    print(f"delay: {result.delay_note}")
    print_tables([identified.table.pick(*COEFFICIENTS)])
    for warning in result.warnings:
        print(f"warning: {warning}")
    print_files(folder, FRICTION_FILE)
