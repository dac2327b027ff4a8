"""Frozen dataclasses to JSON and back, so that a weights file carries the configuration it was made with. Not a
serialiser of arbitrary objects: dataclasses, tuples, strings, numbers, booleans and None.
"""

from __future__ import annotations

import dataclasses
import json
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")


def to_json(config: Any) -> str:
    """The dataclass instance as one line of JSON."""
    return json.dumps(dataclasses.asdict(config), default=str)


def from_json(cls: type[T], text: str) -> T:
    """The instance of the dataclass `cls` written by `to_json`; `__post_init__` validates it as usual.

    Raises:
        ValueError: on a key that `cls` does not have, naming it and those that it has.
    """
    return from_dict(cls, json.loads(text))


def from_dict(cls: type[T], values: dict[str, Any]) -> T:
    """As `from_json`, from the parsed form. Fields that are missing take their defaults."""
    hints = typing.get_type_hints(cls)
    known = [field.name for field in dataclasses.fields(cls)]  # type: ignore[arg-type]
    for key in values:
        if key not in known:
            raise ValueError(f"{cls.__name__} has no field {key!r}, expected some of: {', '.join(known)}")
    return cls(**{key: _convert(hints[key], value) for key, value in values.items()})


def read_card(cls: type[T], key: str, metadata: Mapping[str, str], kind: str, source: str) -> T:
    """The card of a network, from its file's table of strings.

    Args:
        cls: the card's dataclass.
        key: under which `to_json` of it was written.
        metadata: the table.
        kind: what the network is, for errors.
        source: the file's name, for errors.

    Raises:
        ValueError: if the file carries no such card, or a broken one.
    """
    if key not in metadata:
        raise ValueError(f"{source} is not a {kind} of this project: its metadata has no {key!r}")
    try:
        return from_json(cls, metadata[key])
    except (TypeError, ValueError) as error:
        raise ValueError(f"{source}: {error}") from error


def _convert(hint: Any, value: Any) -> Any:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if value is None or (origin is None and isinstance(value, hint if isinstance(hint, type) else object)):
        return value
    if dataclasses.is_dataclass(hint) and isinstance(value, dict):
        return from_dict(typing.cast(type, hint), value)
    if origin is tuple:
        item_hints = [arguments[0]] * len(value) if arguments[-1] is Ellipsis else arguments
        return tuple(_convert(item, part) for item, part in zip(item_hints, value, strict=True))
    if origin in (typing.Union, types.UnionType):
        concrete = [option for option in arguments if option is not type(None)]
        return _convert(concrete[0], value) if len(concrete) == 1 else value
    if hint is Path:
        return Path(value)
    return float(value) if hint is float else value
