"""Configurations from files: what was written comes back, and nothing of another type is taken for a field's."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import pytest

from densecavoid.networks.config_json import from_dict, from_json, to_json


@dataclass(frozen=True)
class Inner:
    size: int = 3


@dataclass(frozen=True)
class Outer:
    name: str
    inner: Inner = Inner()
    kind: Literal["a", "b"] = "a"
    pair: tuple[float, float] = (0.0, 1.0)
    many: tuple[Inner, ...] = ()
    folder: Path | None = None
    source: str | Path = "here"
    rate: float | None = None
    on: bool = False


def test_what_was_written_comes_back() -> None:
    config = Outer("x", Inner(5), "b", (2.0, 3.0), (Inner(1), Inner(2)), Path("/tmp"), "there", 0.5, True)
    assert from_json(Outer, to_json(config)) == config
    assert from_dict(Outer, {"name": "x", "rate": 2, "pair": [1, 2]}) == Outer("x", rate=2.0, pair=(1.0, 2.0))


@pytest.mark.parametrize(
    ("values", "what"),
    [
        ({}, "Outer.name is missing"),
        ([], "Outer is a list, expected a mapping"),
        ({"name": "x", "nme": 1}, "no field 'nme'"),
        ({"name": 3}, "Outer.name is 3, expected a str"),
        ({"name": None}, "Outer.name is None"),
        ({"name": "x", "on": 1}, "Outer.on is 1, expected a bool"),
        ({"name": "x", "inner": 3}, "Inner is a int, expected a mapping"),
        ({"name": "x", "inner": {"size": True}}, "Inner.size is True, expected a int"),
        ({"name": "x", "inner": {"size": 3.0}}, "Inner.size is 3.0, expected a int"),
        ({"name": "x", "kind": "c"}, "Outer.kind is 'c', expected one of: a, b"),
        ({"name": "x", "kind": ["a"]}, "Outer.kind is"),
        ({"name": "x", "pair": [1.0]}, "Outer.pair is .*, expected 2 values"),
        ({"name": "x", "pair": "12"}, "Outer.pair is '12', expected a list"),
        ({"name": "x", "pair": [1.0, "2"]}, "Outer.pair is '2', expected a number"),
        ({"name": "x", "many": [{"size": 1}, 2]}, "Inner is a int"),
        ({"name": "x", "folder": 3}, "Outer.folder is 3, expected a path"),
        ({"name": "x", "source": 3}, "Outer.source is 3"),
        ({"name": "x", "rate": 10**400}, "a number that a float can hold"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(values: Any, what: str) -> None:
    with pytest.raises(ValueError, match=what):
        from_dict(Outer, values)
