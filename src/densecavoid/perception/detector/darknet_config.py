"""Darknet's .cfg files: parsed into layers of known shape. Not the network itself (network.py), nor its weights."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from densecavoid.frames import choose, require
from densecavoid.perception.detector.configurations import SHIPPED

_MAX_CHARACTERS, _MAX_LAYERS, _MAX_FILTERS, _MAX_SIDE = 1_000_000, 1_000, 16_384, 8_192


class Shape(NamedTuple):
    """What a layer gives for one image."""

    channels: int
    height: int
    width: int


@dataclass(frozen=True)
class Convolutional:
    """Convolution, then batch normalisation or a bias, then an activation."""

    filters: int
    size: int
    stride: int
    padding: int
    batch_normalize: bool
    activation: str


@dataclass(frozen=True)
class Maxpool:
    """Greatest value of a window; windows that reach over the right and lower edge see nothing there."""

    size: int
    stride: int
    padding: int
    """Left and right together: the greater half is on the right."""


@dataclass(frozen=True)
class Shortcut:
    """Adds another layer's output to the last one's."""

    source: int


@dataclass(frozen=True)
class Route:
    """The outputs of other layers, one after another along the channels."""

    sources: tuple[int, ...]


@dataclass(frozen=True)
class Upsample:
    """Each pixel `stride` times in each direction."""

    stride: int


@dataclass(frozen=True)
class Yolo:
    """A head: the layer before it gives, for each anchor, x, y, w, h, objectness and one number a class."""

    anchors: tuple[tuple[float, float], ...]
    """Width and height in pixels of the network's input."""
    classes: int


Layer = Convolutional | Maxpool | Shortcut | Route | Upsample | Yolo


@dataclass(frozen=True)
class DarknetConfig:
    """A network: its input, its layers, and the shape of each layer's output."""

    input: Shape
    layers: tuple[Layer, ...]
    shapes: tuple[Shape, ...]

    @property
    def heads(self) -> tuple[tuple[Yolo, Shape], ...]:
        """The heads in the order of the file, with the shape of what each reads."""
        pairs = zip(self.layers, self.shapes, strict=True)
        return tuple((layer, shape) for layer, shape in pairs if isinstance(layer, Yolo))


@dataclass(frozen=True)
class _Section:
    """The part of a file that begins with [kind]."""

    kind: str
    options: Mapping[str, str]
    where: str

    def whole(self, name: str, default: int | None, least: int, most: int) -> int:
        text = self.options.get(name)
        if text is None and default is not None:
            return default
        return _whole(text, f"{self.where} [{self.kind}] {name}", least, most)

    def numbers(self, name: str, convert: Callable[[str], int | float]) -> list:
        text = self.options.get(name, "")
        try:
            return [convert(word) for word in text.split(",")]
        except ValueError:
            raise ValueError(f"{self.where} [{self.kind}] {name} is {text!r}, expected numbers with commas") from None


def _whole(text: str | None, name: str, least: int, most: int) -> int:
    expected = f"a whole number from {least} to {most}"
    try:
        value = int(text or "")
    except ValueError:
        raise ValueError(f"{name} is {text!r}, expected {expected}") from None
    require(least <= value <= most, name, value, expected)
    return value


def load_config(name_or_path: str | Path, size: tuple[int, int] | None = None) -> DarknetConfig:
    """A shipped configuration by name (`configurations.SHIPPED`), or a file.

    Args:
        size: width and height of the network's input instead of those in the file.

    Raises:
        FileNotFoundError: if it is neither.
        ValueError: as `parse_config`.
    """
    return parse_config(read_config_text(name_or_path), str(name_or_path), size)


def read_config_text(name_or_path: str | Path) -> str:
    """The text of a shipped configuration or of a file.

    Raises:
        FileNotFoundError: if it is neither, saying which are shipped.
    """
    if str(name_or_path) in SHIPPED:
        return SHIPPED[str(name_or_path)]()
    path = Path(name_or_path)
    if not path.is_file():
        raise FileNotFoundError(f"no configuration {str(path)!r}: not a file, and not one of {', '.join(SHIPPED)}")
    require(path.stat().st_size <= _MAX_CHARACTERS, f"size of {path}", path.stat().st_size, "at most 1 MB of text")
    return path.read_text(encoding="utf-8", errors="replace")


def parse_config(text: str, source: str = "configuration", size: tuple[int, int] | None = None) -> DarknetConfig:
    """Reads a configuration and finds every layer's shape. Options that only matter in training are passed over.

    Args:
        text: what a .cfg file holds.
        source: its name, for errors.
        size: width and height of the network's input instead of those in the text.

    Raises:
        ValueError: naming the line and what was expected, for what is no .cfg, for layers that this project does not
            know, and for layers that do not fit together.
    """
    sections = _sections(text, source)
    require(bool(sections) and sections[0].kind in ("net", "network"), source, text[:40], "a file that begins [net]")
    net = sections[0]
    shape = Shape(
        net.whole("channels", 3, 1, 64),
        size[1] if size else net.whole("height", None, 1, _MAX_SIDE),
        size[0] if size else net.whole("width", None, 1, _MAX_SIDE),
    )
    require(2 <= len(sections) <= _MAX_LAYERS, f"layers of {source}", len(sections) - 1, f"1 to {_MAX_LAYERS - 1}")
    layers: list[Layer] = []
    shapes: list[Shape] = []
    last = shape
    for section in sections[1:]:
        layer, last = _layer(section, last, shapes)
        layers.append(layer)
        shapes.append(last)
    config = DarknetConfig(shape, tuple(layers), tuple(shapes))
    require(bool(config.heads), f"heads of {source}", 0, "at least one [yolo]")
    require(
        len({head.classes for head, _ in config.heads}) == 1, f"classes of {source}", "unequal", "equal in all heads"
    )
    return config


def _sections(text: str, source: str) -> list[_Section]:
    require(len(text) <= _MAX_CHARACTERS, f"length of {source}", len(text), f"at most {_MAX_CHARACTERS} characters")
    sections: list[_Section] = []
    options: dict[str, str] = {}
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.split("#")[0].split(";")[0].strip()
        if not line:
            continue
        where = f"{source}:{number}"
        if line.startswith("["):
            require(line.endswith("]") and len(line) > 2, where, line, "[a kind of layer]")
            options = {}
            sections.append(_Section(line[1:-1].strip(), options, where))
            continue
        name, equals, value = line.partition("=")
        require(bool(equals) and bool(name.strip()), where, line, "[a kind of layer] or name=value")
        require(bool(sections), where, line, "a [net] section first")
        options[name.strip()] = value.strip()
    return sections


def _layer(section: _Section, last: Shape, shapes: list[Shape]) -> tuple[Layer, Shape]:
    where = f"{section.where} [{section.kind}]"
    known = {
        "convolutional": _convolutional,
        "maxpool": _maxpool,
        "shortcut": _shortcut,
        "route": _route,
        "upsample": _upsample,
        "yolo": _yolo,
    }
    choose(f"layer at {section.where}", section.kind, tuple(known))
    layer, shape = known[section.kind](section, last, shapes)
    fits = min(shape) >= 1 and shape.channels <= 4 * _MAX_FILTERS and max(shape[1:]) <= _MAX_SIDE
    require(fits, f"shape (channels, height, width) of {where}", tuple(shape), f"from 1 to {_MAX_SIDE} a side")
    return layer, shape


def _convolutional(section: _Section, last: Shape, _shapes: list[Shape]) -> tuple[Layer, Shape]:
    size, stride = section.whole("size", 1, 1, 15), section.whole("stride", 1, 1, 8)
    padding = size // 2 if section.whole("pad", 0, 0, 1) else section.whole("padding", 0, 0, 15)
    groups = section.whole("groups", 1, 1, _MAX_FILTERS)
    require(groups == 1, f"{section.where} groups", groups, "1")
    activation = choose(
        f"activation at {section.where}", section.options.get("activation", "logistic"), ("linear", "leaky")
    )
    filters = section.whole("filters", 1, 1, _MAX_FILTERS)
    layer = Convolutional(filters, size, stride, padding, bool(section.whole("batch_normalize", 0, 0, 1)), activation)
    height, width = ((side + 2 * padding - size) // stride + 1 for side in last[1:])
    return layer, Shape(filters, height, width)


def _maxpool(section: _Section, last: Shape, _shapes: list[Shape]) -> tuple[Layer, Shape]:
    stride = section.whole("stride", 1, 1, 8)
    size = section.whole("size", stride, 1, 15)
    padding = section.whole("padding", size - 1, 0, 15)
    height, width = ((side + padding - size) // stride + 1 for side in last[1:])
    return Maxpool(size, stride, padding), Shape(last.channels, height, width)


def _source(section: _Section, name: str, number: int, shapes: list[Shape]) -> int:
    """The layer that a number means: negative ones count back from here."""
    layer = len(shapes) + number if number < 0 else number
    where = f"{section.where} [{section.kind}] {name}"
    require(0 <= layer < len(shapes), where, number, f"one of the {len(shapes)} layers before it")
    return layer


def _shortcut(section: _Section, last: Shape, shapes: list[Shape]) -> tuple[Layer, Shape]:
    where = f"{section.where} [shortcut]"
    choose(f"activation at {section.where}", section.options.get("activation", "linear"), ("linear",))
    source = _source(section, "from", section.whole("from", None, -_MAX_LAYERS, _MAX_LAYERS), shapes)
    require(
        shapes[source] == last, f"shape of layer {source}, added at {where}", tuple(shapes[source]), f"{tuple(last)}"
    )
    return Shortcut(source), last


def _route(section: _Section, _last: Shape, shapes: list[Shape]) -> tuple[Layer, Shape]:
    require("groups" not in section.options, f"{section.where} [route] groups", section.options.get("groups"), "none")
    sources = tuple(_source(section, "layers", n, shapes) for n in section.numbers("layers", int))
    found = [shapes[source] for source in sources]
    same = all(shape[1:] == found[0][1:] for shape in found)
    require(same, f"sizes joined at {section.where} [route]", [tuple(s[1:]) for s in found], "equal height and width")
    return Route(sources), Shape(sum(shape.channels for shape in found), *found[0][1:])


def _upsample(section: _Section, last: Shape, _shapes: list[Shape]) -> tuple[Layer, Shape]:
    stride = section.whole("stride", 2, 1, 8)
    return Upsample(stride), Shape(last.channels, last.height * stride, last.width * stride)


def _yolo(section: _Section, last: Shape, _shapes: list[Shape]) -> tuple[Layer, Shape]:
    where = f"{section.where} [yolo]"
    scale = float(section.options.get("scale_x_y", "1"))
    require(scale == 1.0, f"{where} scale_x_y", scale, "1, as in YOLOv3")
    classes = section.whole("classes", 20, 1, 10_000)
    flat = section.numbers("anchors", float)
    require(len(flat) % 2 == 0 and min(flat) > 0, f"{where} anchors", flat, "pairs of positive numbers")
    pairs = list(zip(flat[::2], flat[1::2], strict=True))
    mask = section.numbers("mask", int) if "mask" in section.options else list(range(len(pairs)))
    require(all(0 <= m < len(pairs) for m in mask), f"{where} mask", mask, f"numbers of the {len(pairs)} anchors")
    wanted = len(mask) * (5 + classes)
    require(last.channels == wanted, f"channels before {where}", last.channels, f"{wanted} = anchors x (5 + classes)")
    return Yolo(tuple(pairs[m] for m in mask), classes), last
