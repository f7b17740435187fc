"""The model that is handed out by default: the one place that decides which parameters that are.

`load_model`, `predict`, `monitor` and the exports hand it out; verdict, acceptance and the report's headline grade it.
"""

from __future__ import annotations

from typing import Literal

Parameters = Literal["consistent", "full", "essential"]
"""Parameters of bodies that can exist; all base parameters as estimated; the significant ones, the others 0."""

DeliveredParameters = Literal["consistent", "full"]

DELIVERED_WORDS: dict[DeliveredParameters, str] = {"consistent": "physically consistent", "full": "unconstrained"}


def delivered_parameters(consistent: object | None) -> DeliveredParameters:
    """The physically consistent parameters where there are any (None: none were found), else the full ones."""
    return "full" if consistent is None else "consistent"
