"""Rendering of the page templates into one self-contained HTML file."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from ident.report.table_html import table_html
from ident.views import number_text

if TYPE_CHECKING:
    from jinja2 import Environment


@cache
def page_templates(*packages: str) -> Environment:
    """The templates of these packages and, behind them, those of the report: its style, script and macros.

    They know the number filters, `dash`, `table_html`, and `plotlyjs`, the plotting library as text. What they are
    given is escaped.
    The same packages get the same environment, whose templates are compiled once: that is most of what a page costs.
    """
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup
    from plotly.offline import get_plotlyjs

    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package) for package in (*packages, "ident.report")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals |= {"dash": number_text.DASH, "plotlyjs": Markup(get_plotlyjs()), "table_html": table_html}
    for name in ("number", "percent", "percentage", "whole", "with_error", "half_interval", "setting"):
        environment.filters[name] = getattr(number_text, name)
    return environment
