"""The commands of the acquisition side, for the entry-point group `dynid.commands`."""

from __future__ import annotations

app = {"record": "daq.commands.record", "import": "daq.commands.import_file", "recover": "daq.commands.recover"}
"""The module of each command."""
