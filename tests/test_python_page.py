"""The Python page: what it shows of each name is what Python has."""

import importlib
import inspect
import re
from pathlib import Path

import pytest

import mfd_bayes as mb

griffe = pytest.importorskip("griffe", reason='needs the extra "docs": pip install ".[docs]"')

PACKAGE = Path(mb.__file__).parent
PAGE = Path(__file__).parent.parent / "docs/pages/python.md"
NAMES = re.findall(r"^::: (\S+)", PAGE.read_text(encoding="utf-8"), re.MULTILINE)


@pytest.fixture(scope="module")
def package():
    """The package as the site's builder reads it."""
    return griffe.load("mfd_bayes", search_paths=[PACKAGE.parent], docstring_parser="numpy")


def python_of(name):
    """The object of a name on the page."""
    module, _, what = name.rpartition(".")
    return getattr(importlib.import_module(module), what)


def callables(name):
    """What has parameters under a name on the page: itself, or its public methods."""
    found = python_of(name)
    yield name, found
    if inspect.isclass(found):
        for method, function in vars(found).items():
            function = getattr(function, "__func__", function)
            if inspect.isfunction(function) and not method.startswith("_"):
                yield f"{name}.{method}", function


def shown_defaults(package, name):
    """Default of each parameter as the page shows it beside the parameter's meaning."""
    described = package[name.removeprefix("mfd_bayes.")].docstring
    sections = described.parsed if described else []
    return {
        item.name: item.default
        for section in sections
        if section.kind.value == "parameters"
        for item in section.value
    }


def test_defaults_on_the_page_are_those_of_python(package):
    for path, function in (pair for name in NAMES for pair in callables(name)):
        for parameter, shown in shown_defaults(package, path).items():
            real = inspect.signature(function).parameters[parameter].default
            if shown is not None:
                named = vars(importlib.import_module(function.__module__)).get(str(shown))
                said = str(shown).strip("'\"") if named is None else str(named)
                assert said == str(real), f"{path}: {parameter}"


def test_a_first_choice_that_is_no_default_would_be_seen():
    said = griffe.Docstring(
        'Word.\n\nParameters\n----------\nkind : {"device", "new_test"}\n', parser="numpy"
    )
    (section,) = (s for s in said.parsed if s.kind.value == "parameters")
    assert section.value[0].default == '"device"'
