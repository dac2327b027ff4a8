"""What every test stands on: quiet threads, no display, checked shapes and types, the folder of recordings."""

from __future__ import annotations

import os
import re
from pathlib import Path

# Before anything imports OpenMP or matplotlib.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ["MPLBACKEND"] = "Agg"

import pytest
from jaxtyping import install_import_hook

REPOSITORY = Path(__file__).resolve().parents[1]


COMPILED = re.compile(r"^\s*@(?:\w+\.)*(?:kernel|inner|njit|jit|vectorize|guvectorize)\b", re.MULTILINE)


def modules_to_check() -> list[str]:
    """Modules whose annotations are checked at every call: all but those with functions that numba compiles.

    The hook wraps each function under its other decorators, and numba cannot compile a wrapped function.
    """
    source = REPOSITORY / "src"
    return [
        ".".join(path.relative_to(source).with_suffix("").parts)
        for path in sorted((source / "densecavoid").rglob("*.py"))
        # A package's name would stand for all modules below it.
        if path.name != "__init__.py" and not COMPILED.search(path.read_text("utf-8"))
    ]


# An int is a float where annotations are concerned (PEP 484), which beartype leaves to be asked for.
install_import_hook(modules_to_check(), "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))")


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The real recordings: DENSECAVOID_DATA, or shared/data beside the repository."""
    given = os.environ.get("DENSECAVOID_DATA")
    path = Path(given) if given else REPOSITORY.parent / "shared" / "data"
    if not path.is_dir():
        pytest.skip(f"no recordings at {path}: set DENSECAVOID_DATA to the folder that has hermes/ in it")
    return path
