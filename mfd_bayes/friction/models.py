"""Models by name: those of the package, of a user's file, and of installed packages."""

from __future__ import annotations

import importlib.util
import re
import sys
import traceback
from collections.abc import Mapping
from hashlib import sha256
from importlib.machinery import SourceFileLoader
from importlib.metadata import entry_points
from pathlib import Path
from types import CodeType, MappingProxyType
from typing import Any

from mfd_bayes.errors import FitError, MfdError
from mfd_bayes.friction.backlash import BacklashLuGre
from mfd_bayes.friction.bouc_wen import BoucWen
from mfd_bayes.friction.model import Model
from mfd_bayes.friction.three_stage import LuGre, ThreeStage

MODELS: Mapping[str, Model] = MappingProxyType(
    {model.name: model for model in (ThreeStage(), LuGre(), BoucWen(), BacklashLuGre())}
)
"""The package's models by their names in campaign files."""

GROUP = "mfd_bayes.models"  # entry points by which an installed package offers models


def file_of(name: str) -> str:
    """File of a model's name, "my_file.py" of "my_file.py:MyClass"; empty for any other name."""
    match = re.fullmatch(r"(.*\.py)(:\w*)?", name, re.DOTALL)
    return match[1] if match else ""


def model_names() -> tuple[str, ...]:
    """Names of the package's models and of installed packages'."""
    return (*MODELS, *(point.name for point in entry_points(group=GROUP)))


def find_model(name: str, folder: Path | None = None) -> Model:
    """Model of a name: one of ours, ``"file.py:Class"``, or an entry point of `GROUP`.

    A file is run. With a `folder`, its path is relative to it and, with links resolved, must lie
    in it.
    """
    points = {point.name: point for point in entry_points(group=GROUP)}
    if isinstance(name, str):
        if name in MODELS:
            return MODELS[name]
        if file_of(name):
            return _of_file(name, folder)
        if name in points:
            try:
                return _made(points[name].load(), f"the entry point {name!r}", points[name].value)
            except MfdError:
                raise
            except Exception as error:
                kind = type(error).__name__
                raise FitError(f"the model {name!r} cannot be loaded: {kind}: {error}") from error
    raise FitError(
        f"unknown model {name!r}: expected one of {', '.join([*MODELS, *points])}, or "
        "my_file.py:MyClass"
    )


class _Source(SourceFileLoader):
    """Loader of what a file says: bytecode beside it may be of another text, or another person."""

    def get_code(self, fullname: str) -> CodeType:
        """Code of the file's text."""
        path = self.get_filename(fullname)
        return self.source_to_code(self.get_data(path), path)


def _of_file(name: str, folder: Path | None) -> Model:
    """Model of "file.py:Class"."""
    file, _, class_name = name.rpartition(":") if not name.endswith(".py") else (name, "", "")
    path = (folder or Path()) / file
    try:
        is_inside = folder is None or path.resolve().is_relative_to(folder.resolve())
        exists = path.is_file()
    except (OSError, RuntimeError, ValueError) as error:
        raise FitError(f"the model's file {file!r} cannot be found: {error}") from error
    if not is_inside:
        raise FitError(f"the model's file {file!r} lies outside the campaign's folder, {folder}")
    if not exists:
        raise FitError(f"there is no file {path} for the model {name!r}")
    path = path.resolve()
    module_name = f"{path.stem}_{sha256(str(path).encode()).hexdigest()[:12]}"
    loader = _Source(module_name, str(path))
    spec = importlib.util.spec_from_file_location(module_name, path, loader=loader)
    if spec is None or spec.loader is None:
        raise FitError(f"the model's file {path} cannot be read as Python")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module  # dataclasses look for it there
    try:
        spec.loader.exec_module(module)
    except MfdError as error:
        text = str(error)
        raise FitError(text if path.name in text else f"{path.name}: {text}") from error
    except (Exception, SystemExit) as error:
        kind, line = type(error).__name__, _line(error, path)
        raise FitError(f"the model's file {path.name} failed{line} with {kind}: {error}") from error
    classes = [
        key
        for key, value in vars(module).items()
        if isinstance(value, type) and issubclass(value, Model) and value.__module__ == module_name
    ]
    if not class_name or not hasattr(module, class_name):
        lack = f"there is no class {class_name} in" if class_name else "say which class of"
        has = f"it has {', '.join(classes)}" if classes else "it has no subclass of mfd_bayes.Model"
        raise FitError(f"{lack} {path.name}: expected {path.name}:MyClass; {has}")
    return _made(
        getattr(module, class_name), f"{class_name} in {path.name}", f"{path}:{class_name}"
    )


def _made(cls: Any, label: str, source: str) -> Model:
    """The model of a class, checked."""
    if not (isinstance(cls, type) and issubclass(cls, Model) and cls is not Model):
        raise FitError(f"{label} must be a class on top of mfd_bayes.Model")
    for name, example in (("name", "'viscous'"), ("quantities", "(Parameter('k', 'kip/in'),)")):
        if not getattr(cls, name, ""):
            missing = "parameters" if name == "quantities" else name
            raise FitError(f"{label} needs {missing}, such as {example}")
    if not (isinstance(cls.name, str) and re.fullmatch(r"[A-Za-z]\w*", cls.name)):
        raise FitError(f"{label}: its name must be a word, got {cls.name!r:.60}")
    if cls.name in MODELS and type(MODELS[cls.name]) is not cls:
        raise FitError(f"{label}: its name {cls.name!r} is that of a model of mfd_bayes")
    if "force" not in cls.own and cls.compute_force is Model.compute_force:
        raise FitError(f"{label} needs a function force(self, theta, trace)")
    cls.source = source
    if ".py:" in source:
        # another process reads the file again
        setattr(cls, "__reduce__", lambda model: (find_model, (model.source,)))  # noqa: B010
    try:
        return cls()
    except (Exception, SystemExit) as error:
        kind = type(error).__name__
        raise FitError(f"{label} cannot be made without arguments: {kind}: {error}") from error


def _line(error: BaseException, path: Path) -> str:
    """Line of the file at which it failed, in words; empty where that is not known."""
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if frame.filename == str(path)]
    line = lines[-1] if lines else getattr(error, "lineno", None)
    return f" in line {line}" if line else ""
