"""The front door: names, docstrings, examples, units; and what `import dynid` does not import."""

from __future__ import annotations

import ast
import doctest
import functools
import inspect
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import dynid

HEAVY = ("numpy", "scipy", "pinocchio", "h5py", "pydantic", "yaml", "plotly", "rosbags", "pandas", "xarray")

PHYSICAL = {
    "bandwidth", "com", "current", "ddq", "delay", "dq", "duration", "inertia", "mass", "period",
    "position", "position_cutoff", "q", "ramp", "rate", "smoothing", "split", "start", "stop", "tau", "temperature",
    "time", "torque", "torque_cutoff", "velocity", "voltage", "significance",
}  # fmt: skip
"""Arguments that stand for a physical quantity, wherever they occur."""

UNIT = re.compile(r"\[[^\]]*(s|rad|Hz|kg|N·m|A|V|°C|m|%)[^\]]*\]")

PACKAGES = {"drivers", "daq", "ident", "sim_drivers", "dynid"}
NAMES = dir(dynid)
CLASSES = [name for name in NAMES if inspect.isclass(getattr(dynid, name))]
ERRORS = [name for name in CLASSES if issubclass(getattr(dynid, name), Exception)]
EXEMPLARY = [name for name in NAMES if name not in ERRORS or name == "DynidError"]
"""The kinds of error differ in one sentence only; the first one shows how they are caught."""

FUNCTIONS = [name for name in NAMES if inspect.isfunction(getattr(dynid, name))]


def public_callables() -> list[tuple[str, Any]]:
    """Functions, and the methods and properties of public classes that dynid defines."""
    found = [(name, getattr(dynid, name)) for name in FUNCTIONS]
    for name in CLASSES:
        if name in ERRORS or name == "RobotFile":
            continue
        public = getattr(dynid, name)
        own = [vars(part) for part in public.__mro__ if part.__module__.partition(".")[0] in PACKAGES]
        for member, value in (item for part in own for item in part.items()):
            if member.startswith("_"):
                continue
            plain = getattr(value, "__func__", getattr(value, "fget", getattr(value, "func", value)))
            if inspect.isfunction(plain):
                found.append((f"{name}.{member}", plain))
    return found


def test_the_table_of_names_is_that_of_the_type_checker():
    tree = ast.parse(Path(dynid.__file__).read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    imported = {
        (node.module, alias.name) for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert imported == {(module, name) for name, module in dynid._MODULE_OF.items()}
    assert 30 <= len(NAMES) <= 60


def test_a_wrong_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'identfy'"):
        dynid.identfy  # noqa: B018


def test_import_dynid_imports_nothing_heavy():
    code = f"import sys, dynid; sys.exit(' '.join(name for name in {HEAVY!r} if name in sys.modules) or 0)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr


def test_neither_using_one_name_nor_starting_a_command_imports_the_numerics():
    code = (
        "import sys, dynid; from dynid.command import build_app; dynid.load_robot('ur5e'); build_app(); "
        "sys.exit('scipy' in sys.modules or 'pinocchio' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr


def test_every_public_name_has_a_docstring_of_a_short_first_line():
    docs = {name: inspect.getdoc(getattr(dynid, name)) or "" for name in NAMES}
    assert [name for name, doc in docs.items() if not doc.strip() or len(doc.splitlines()[0]) > 120] == []


def test_every_public_name_has_an_example():
    assert [name for name in EXEMPLARY if ">>> " not in (inspect.getdoc(getattr(dynid, name)) or "")] == []


def test_every_physical_argument_names_its_unit():
    without = []
    docs = {name: inspect.getdoc(function) or "" for name, function in public_callables()}
    for name, function in public_callables():
        doc = docs[name]
        assert doc.strip(), f"{name} has no docstring"
        if named := re.search(r"Arguments(?: and errors)? are\s+those of `(\w+)`", doc):
            doc = docs[f"{name.rpartition('.')[0]}.{named[1]}"]
        entries = dict(re.findall(r"^\s{4}(\w+): (.*(?:\n\s{8}.*)*)", doc, re.MULTILINE))
        for argument in PHYSICAL.intersection(inspect.signature(function).parameters):
            text = entries.get(argument, "")
            if not UNIT.search(text) and "the same of" not in text:
                without.append(f"{name}: '{argument}' names no unit: {text!r}")
    assert without == []


def test_every_argument_of_a_public_function_is_described():
    without = []
    for name in FUNCTIONS:
        doc = inspect.getdoc(getattr(dynid, name)) or ""
        for argument in inspect.signature(getattr(dynid, name)).parameters:
            if not re.search(rf"^\s+{argument}: ", doc, re.MULTILINE):
                without.append(f"{name}: '{argument}'")
    assert without == []


@pytest.mark.usefixtures("not_simulated", "stated_friction", "mistakes_not_sought")
def test_the_examples_run(monkeypatch):
    for costly in ("simulate", "identify", "design_excitation", "compare"):
        monkeypatch.setitem(vars(dynid), costly, _remembered(costly))
    parser, output = doctest.DocTestParser(), []
    tried = failed = 0
    for name in EXEMPLARY:
        value = inspect.unwrap(getattr(dynid, name))
        objects = [(name, value)]
        if inspect.isclass(value):
            for member, function in vars(value).items():
                plain = getattr(function, "__func__", function)
                if inspect.isfunction(plain) and not member.startswith("_"):
                    objects.append((f"{name}.{member}", plain))
        runner = doctest.DocTestRunner(optionflags=doctest.IGNORE_EXCEPTION_DETAIL)
        for label, documented in objects:
            runner.run(parser.get_doctest(inspect.getdoc(documented) or "", {}, label, None, 0), out=output.append)
        counts = runner.summarize(verbose=False)
        tried, failed = tried + counts.attempted, failed + counts.failed
    assert failed == 0, "".join(output)
    assert tried > 100


@functools.cache
def _remembered(name: str) -> Any:
    """A costly function that computes each of its examples once for the whole session."""
    function = getattr(dynid, name)
    function = inspect.unwrap(function)
    known: dict[str, Any] = {}
    kept = []

    @functools.wraps(function)
    def remembered(*arguments: Any, **named: Any) -> Any:
        if name == "simulate" and named.get("duration", 0.0) > 5.0:  # an eighth of what the arm's own rate gives
            named = {"rate": 62.5} | named
        key = repr([_key(value) for value in (*arguments, *named, *named.values())])
        if key not in known:
            kept.append((arguments, named))  # or another object may get the same id
            known[key] = function(*arguments, **named)
        return known[key]

    return remembered


def _key(value: Any) -> Any:
    return value if isinstance(value, (str, int, float, tuple)) else id(value)


@pytest.mark.parametrize("name", ["drivers", "daq", "ident", "sim_drivers"])
def test_a_folder_that_hides_one_of_our_packages_is_named_with_its_path(tmp_path, monkeypatch, name):
    folder = tmp_path / name
    folder.mkdir()
    (folder / "__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, name, raising=False)
    with pytest.raises(ImportError, match=re.escape(f"'{name}' is hidden by {folder / '__init__.py'}")):
        dynid._refuse_hidden_packages()
