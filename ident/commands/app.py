"""The commands of the identification side, for the entry-point group `dynid.commands`."""

from __future__ import annotations

_FOLDERS = {
    "preparation": ("robot", "robots", "check", "lint", "excite", "sweep", "info"),
    "identification": ("identify", "validate", "compare", "bench", "fleet", "merge", "payload", "gains", "friction"),
    "use": ("predict", "monitor", "diff", "history", "export"),
}
_MODULES = {"robots": "robot", "gains": "payload"}  # where a command's module is not named after it

app = {
    name: f"ident.commands.{folder}.{_MODULES.get(name, name)}" for folder, names in _FOLDERS.items() for name in names
}
"""The module of each command."""
