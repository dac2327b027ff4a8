"""What is imported only when it is asked for, so that a robot does not wait for the simulator or Gymnasium."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any


def attribute_of(package: str, homes: Mapping[str, str], name: str) -> object:
    """A package's attribute, from the module that it lives in (PEP 562).

    Raises:
        AttributeError: if the package does not have it.
    """
    if name not in homes:
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(homes[name]), name)
    setattr(sys.modules[package], name, value)
    return value


def _register() -> None:
    from densecavoid.env.registration import register_environments

    register_environments()


class _AfterGymnasium(MetaPathFinder):
    """Registers our environments as soon as somebody has imported gymnasium, and not before."""

    def find_spec(self, fullname: str, path: Any, target: ModuleType | None = None) -> ModuleSpec | None:
        if fullname != "gymnasium":
            return None
        sys.meta_path.remove(self)
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_and_register(module: ModuleType) -> None:
                execute(module)
                _register()

            spec.loader.exec_module = execute_and_register  # type: ignore[method-assign]
        return spec


def register_with_gymnasium() -> None:
    """Makes the environments known to `gymnasium.make`, now or whenever gymnasium is imported."""
    if "gymnasium" in sys.modules:
        _register()
    else:
        sys.meta_path.insert(0, _AfterGymnasium())
