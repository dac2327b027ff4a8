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

from densecavoid.frames import require

T = TypeVar("T")


def to_json(config: Any) -> str:
    """The dataclass instance as one line of JSON."""
    return json.dumps(dataclasses.asdict(config), default=str)


def from_json(cls: type[T], text: str) -> T:
    """The instance of the dataclass `cls` written by `to_json`; `__post_init__` validates it as usual.

    Raises:
        ValueError: on a key that `cls` does not have, naming it and those that it has; and as `from_dict`.
    """
    return from_dict(cls, json.loads(text))


def from_dict(cls: type[T], values: Any) -> T:
    """As `from_json`, from the parsed form. Fields that are missing take their defaults.

    Raises:
        ValueError: also for what is no mapping, for a value of another type than its field's, naming both, and for a
            field without a default that is missing. Integers are numbers too; texts and booleans are neither.
    """
    if not isinstance(values, dict):
        raise ValueError(f"{cls.__name__} is a {type(values).__name__}, expected a mapping of names to values")
    hints = typing.get_type_hints(cls)
    fields = {field.name: field for field in dataclasses.fields(cls)}  # type: ignore[arg-type]
    for key in values:
        if key not in fields:
            raise ValueError(f"{cls.__name__} has no field {key!r}, expected some of: {', '.join(fields)}")
    for name, field in fields.items():
        if name not in values and field.default is field.default_factory is dataclasses.MISSING:
            raise ValueError(f"{cls.__name__}.{name} is missing")
    return cls(**{key: _convert(hints[key], value, f"{cls.__name__}.{key}") for key, value in values.items()})


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
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"{source}: {error}") from error


def _convert(hint: Any, value: Any, name: str) -> Any:
    """A value of parsed JSON or YAML as a field's type has it."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any:
        return value
    if origin in (typing.Union, types.UnionType):
        return _convert_either(arguments, value, name)
    if origin is typing.Literal:
        known = any(type(value) is type(option) and value == option for option in arguments)
        require(known, name, value, f"one of: {', '.join(map(str, arguments))}")
        return value
    if dataclasses.is_dataclass(hint):
        return value if isinstance(value, typing.cast(type, hint)) else from_dict(typing.cast(type, hint), value)
    if origin is tuple:
        require(isinstance(value, (list, tuple)), name, value, "a list")
        item_hints = [arguments[0]] * len(value) if arguments[-1] is Ellipsis else arguments
        require(len(value) == len(item_hints), name, value, f"{len(item_hints)} values")
        return tuple(_convert(item, part, name) for item, part in zip(item_hints, value, strict=True))
    if hint is float:
        require(isinstance(value, (int, float)) and not isinstance(value, bool), name, value, "a number")
        try:
            return float(value)
        except OverflowError:
            raise ValueError(f"{name} is {str(value)[:20]}..., expected a number that a float can hold") from None
    if hint is Path:
        require(isinstance(value, (str, Path)), name, value, "a path")
        return Path(value)
    kind = origin or hint
    # A boolean is an int to Python, and to nobody else.
    known = isinstance(value, kind) and not (kind is int and isinstance(value, bool))
    require(known, name, value, f"a {kind.__name__}")
    return value


def _convert_either(options: tuple[Any, ...], value: Any, name: str) -> Any:
    """As the first of a union's types that takes it."""
    if value is None and type(None) in options:
        return None
    refusals = []
    for option in options:
        if option is not type(None):
            try:
                return _convert(option, value, name)
            except ValueError as error:
                refusals.append(error)
    raise refusals[0]
