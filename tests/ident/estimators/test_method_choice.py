"""Methods are found by their place, and their options are typed and described."""

from __future__ import annotations

import re
from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest
from each import each

from drivers.core.errors import UsageError
from ident.estimators import methods
from ident.estimators.method_choice import all_methods, chosen_method, describe_methods
from ident.identify.identification import IdentifyChoices

DOCS = Path(__file__).parents[3] / "docs" / "identification.md"


def test_every_module_of_the_folder_is_a_method():
    files = {path.stem.replace("_", "-") for path in Path(methods.__path__[0]).glob("*.py")} - {"--init--"}
    assert set(all_methods()) == files >= {"ols", "wls", "energy", "power", "pso"}


@pytest.mark.parametrize("name", list(all_methods()))
def test_every_option_has_a_default_and_is_described(name):
    options = all_methods()[name].options
    assert is_dataclass(options)
    assert chosen_method(name).options == options()
    described = describe_methods()
    for field in fields(options):
        assert f"  {field.name}=" in described
    assert re.search(rf"\n\| [^|]*`{name}`", DOCS.read_text(encoding="utf-8"))


def test_values_are_typed():
    assert chosen_method("energy:window=0.5").values == {"window": 0.5}
    assert IdentifyChoices("energy:window=0.5").estimator.equations == "energy"


@each("text", ["", "WLS", "wls:", "wls:=", "energy:window=", "energy:window=1:", "energy=1", "é:ö=ü"])
def test_what_is_no_method_is_refused_in_one_line(text):
    with pytest.raises(UsageError) as refused:
        IdentifyChoices(text)
    assert "\n" not in str(refused.value)
