"""A floor plan and its crowd from a small TOML file (docs/building.md says what it may hold)."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from densecavoid.scenarios.building import KINDS, Building, CrowdLine, Spot
from densecavoid.scenarios.ros_map import RosMap, read_ros_map
from densecavoid.sim.floorplan import WALL_HEIGHT_M, WALL_THICKNESS_M, FloorPlan
from densecavoid.sim.furniture import PIECES, kerb, place, ramp
from densecavoid.sim.materials import MATERIALS
from densecavoid.sim.mesh import load_mesh

_MATERIALS = tuple(material.name for material in MATERIALS)
_SOLID = tuple(material.name for material in MATERIALS if not material.see_through)
_MISSING: Any = object()


@dataclass
class _Wall:
    line: tuple[float, float, float, float]
    thickness: float
    material: str
    doors: list[tuple[float, float]]


class _Table:
    """One table of a TOML file whose entries are taken out one by one; what is left at the end is an error."""

    def __init__(self, where: str, values: object) -> None:
        self.where = where
        if not isinstance(values, dict):
            raise ValueError(f"{where} is {values!r}, expected a table {{ key = value, ... }}")
        self._left = dict(values)
        self._known: list[str] = []

    def take(self, key: str, default: Any = _MISSING) -> Any:
        self._known.append(key)
        if key not in self._left and default is _MISSING:
            raise ValueError(f"{self.where}: {key} is missing")
        return self._left.pop(key, default)

    def has(self, key: str) -> bool:
        return key in self._left

    def wrong(self, key: str, value: object, expected: str) -> ValueError:
        return ValueError(f"{self.where}: {key} is {value!r}, expected {expected}")

    def number(self, key: str, default: Any = _MISSING, low: float = -math.inf, high: float = math.inf) -> float:
        value = self.take(key, default)
        if not _is_number(value) or not low <= value <= high:
            limits = "" if (low, high) == (-math.inf, math.inf) else f" in [{low:g}, {high:g}]"
            raise self.wrong(key, value, f"a number{limits}")
        return float(value)

    def length(self, key: str, default: Any = _MISSING) -> float:
        return self.number(key, default, low=1e-3, high=1e4)

    def text(self, key: str) -> str:
        value = self.take(key)
        if not isinstance(value, str) or not value:
            raise self.wrong(key, value, "text")
        return value

    def flag(self, key: str, default: Any = _MISSING) -> bool:
        value = self.take(key, default)
        if not isinstance(value, bool):
            raise self.wrong(key, value, "true or false")
        return value

    def whole(self, key: str, default: Any = _MISSING) -> int:
        value = self.take(key, default)
        if not isinstance(value, int) or isinstance(value, bool):
            raise self.wrong(key, value, "a whole number")
        return value

    # What may be left out gives its default, of any type; the two below are otherwise tuples of floats.

    def numbers(self, key: str, names: str, default: Any = _MISSING) -> Any:
        value = self.take(key, default)
        if value is default and default is not _MISSING:
            return value
        expected = f"numbers [{names}]"
        if not isinstance(value, list) or len(value) != len(names.split(",")):
            raise self.wrong(key, value, expected)
        if not all(_is_number(v) and math.isfinite(v) for v in value):
            raise self.wrong(key, value, expected)
        return tuple(map(float, value))

    def area(self, key: str = "area", default: Any = _MISSING) -> Any:
        value = self.numbers(key, "x_min, y_min, x_max, y_max", default)
        if value is not default and not (value[0] < value[2] and value[1] < value[3]):
            raise self.wrong(key, list(value), "[x_min, y_min, x_max, y_max] with x_min < x_max and y_min < y_max")
        return value

    def choice(self, key: str, known: tuple[str, ...], default: Any = _MISSING) -> str:
        value = self.take(key, default)
        if not isinstance(value, str) or value not in known:
            raise self.wrong(key, value, f"one of: {', '.join(known)}")
        return value

    def tables(self, key: str) -> list[_Table]:
        value = self.take(key, [])
        if not isinstance(value, list):
            raise self.wrong(key, value, f"a list of tables, each under [[{key}]]")
        return [_Table(f"{self.where}: {key} {k}", v) for k, v in enumerate(value, start=1)]

    def done(self) -> None:
        if self._left:
            key, value = next(iter(self._left.items()))
            raise ValueError(f"{self.where}: {key} = {value!r} is not known, expected one of: {', '.join(self._known)}")


def read_plan(path: Path) -> Building:
    """The building that a TOML file describes.

    Raises:
        ValueError: naming the file, the key, its value and what was expected; or that start and goal are not joined.
        OSError: if a file cannot be read.
    """
    if not path.is_file():
        raise ValueError(f"plan: no file {path}, expected a floor plan in TOML")
    try:
        document = tomllib.loads(path.read_text("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: is no TOML: {error}") from error
    top = _Table(str(path), document)
    plan = FloorPlan(ceiling_m=top.number("ceiling", WALL_HEIGHT_M, low=0.1))
    ros_map = _map(top, path, plan)
    walls = [*_rooms(top), *_walls(top)]
    _cut_doors(top, walls)
    for wall in walls:
        plan.wall(*wall.line, wall.thickness, wall.material, wall.doors)
    for adder in (_boxes, _pillars, _furniture, _low):
        adder(top, plan)
    _meshes(top, plan, path.parent)
    start, goal = _spot(top, "start", with_yaw=True), _spot(top, "goal", with_yaw=False)
    distance = top.numbers("distance", "least, most", (4.0, 25.0))
    if not 0 < distance[0] < distance[1]:
        raise top.wrong("distance", list(distance), "[least, most] in metres, least above 0")
    limit = top.length("time_limit") if top.has("time_limit") else top.take("time_limit", None)
    crowd = _crowd(top)
    top.done()
    return Building(f"plan:{path.name}", plan, ros_map, start, goal, crowd, (distance[0], distance[1]), limit)


def _map(top: _Table, path: Path, plan: FloorPlan) -> RosMap | None:
    name = top.take("map", None)
    if name is None:
        return None
    if not isinstance(name, str) or not (path.parent / name).is_file():
        raise top.wrong("map", name, f"a map.yaml beside {path.name}, by its path from there")
    ros_map = read_ros_map(path.parent / name)
    ros_map.add_walls(plan)
    return ros_map


def _rooms(top: _Table) -> list[_Wall]:
    walls = []
    for room in top.tables("room"):
        x0, y0, x1, y1 = room.area()
        thickness, material = room.length("thickness", WALL_THICKNESS_M), room.choice("material", _MATERIALS, "plaster")
        t = thickness / 2
        corners = [(x0 - t, y0 - t), (x1 + t, y0 - t), (x1 + t, y1 + t), (x0 - t, y1 + t)]
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
            walls.append(_Wall((*a, *b), thickness, material, []))
        room.done()
    return walls


def _walls(top: _Table) -> list[_Wall]:
    walls = []
    for wall in top.tables("wall"):
        line = wall.numbers("line", "x0, y0, x1, y1")
        if line[:2] == line[2:]:
            raise wall.wrong("line", list(line), "two different ends")
        thickness, material = wall.length("thickness", WALL_THICKNESS_M), wall.choice("material", _MATERIALS, "plaster")
        walls.append(_Wall((line[0], line[1], line[2], line[3]), thickness, material, []))
        wall.done()
    return walls


def _cut_doors(top: _Table, walls: list[_Wall]) -> None:
    """A door opens every wall that it lies on: rooms side by side have two there."""
    for door in top.tables("door"):
        x, y = door.numbers("at", "x, y")
        width = door.length("width", 0.9)
        found = False
        for wall in walls:
            x0, y0, x1, y1 = wall.line
            length = math.dist((x0, y0), (x1, y1))
            along = ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / length
            across = abs((x - x0) * (y1 - y0) - (y - y0) * (x1 - x0)) / length
            if across <= wall.thickness + 1e-6 and 0 <= along <= length:
                ends = (along - width / 2, along + width / 2)
                taken = any(abs(along - a) < (width + w) / 2 for a, w in wall.doors)
                if ends[0] < -wall.thickness / 2 or ends[1] > length + wall.thickness / 2 or taken:
                    raise door.wrong("at", [x, y], f"room for a width of {width:g} m in its wall, clear of other doors")
                wall.doors.append((along, width))
                found = True
        if not found:
            raise door.wrong("at", [x, y], "a point on a wall")
        door.done()


def _boxes(top: _Table, plan: FloorPlan) -> None:
    for box in top.tables("box"):
        x, y = box.numbers("at", "x, y")
        length, width = box.numbers("size", "length, width")
        z_min, z_max = box.numbers("z", "bottom, top", (0.0, 1.0))
        if not (length > 0 and width > 0 and 0 <= z_min < z_max):
            raise box.wrong("size and z", [length, width, z_min, z_max], "positive sizes, bottom below top")
        yaw, material = math.radians(box.number("yaw_deg", 0.0)), box.choice("material", _MATERIALS, "wood")
        plan.box(x, y, length, width, yaw, z_min, z_max, material)
        box.done()


def _pillars(top: _Table, plan: FloorPlan) -> None:
    for pillar in top.tables("pillar"):
        x, y = pillar.numbers("at", "x, y")
        radius = pillar.length("radius")
        z_min, z_max = pillar.numbers("z", "bottom, top", (0.0, WALL_HEIGHT_M))
        if not 0 <= z_min < z_max:
            raise pillar.wrong("z", [z_min, z_max], "bottom below top")
        plan.pillar(x, y, radius, z_min, z_max, pillar.choice("material", _SOLID, "concrete"))
        pillar.done()


def _furniture(top: _Table, plan: FloorPlan) -> None:
    for piece in top.tables("furniture"):
        kind, (x, y) = piece.choice("kind", tuple(PIECES)), piece.numbers("at", "x, y")
        place(plan, kind, x, y, math.radians(piece.number("yaw_deg", 0.0)))
        piece.done()


def _meshes(top: _Table, plan: FloorPlan, folder: Path) -> None:
    for piece in top.tables("mesh"):
        file, (x, y) = piece.text("file"), piece.numbers("at", "x, y")
        scale, up = piece.length("scale", 1.0), piece.choice("up", ("z", "y"), "z")
        allow_open, material = piece.flag("allow_open", False), piece.choice("material", _SOLID, "wood")
        yaw, z = math.radians(piece.number("yaw_deg", 0.0)), piece.number("z", 0.0)
        try:
            mesh = load_mesh(folder / file, scale, "y" if up == "y" else "z", allow_open, material)
        except (ValueError, ModuleNotFoundError) as error:
            raise ValueError(f"{piece.where}: {error}") from error
        plan.mesh(mesh, x, y, yaw, z)
        piece.done()


def _low(top: _Table, plan: FloorPlan) -> None:
    for stone in top.tables("kerb"):
        x0, y0, x1, y1 = stone.numbers("line", "x0, y0, x1, y1")
        height, width = stone.number("height", 0.12, low=0.01, high=0.2), stone.length("width", 0.15)
        kerb(plan, x0, y0, x1, y1, height, width)
        stone.done()
    for slope in top.tables("ramp"):
        x, y = slope.numbers("at", "x, y")
        length, width = slope.numbers("size", "length, width")
        if min(length, width) <= 0:
            raise slope.wrong("size", [length, width], "positive sizes")
        yaw = math.radians(slope.number("yaw_deg", 0.0))
        ramp(plan, x, y, length, width, yaw, slope.number("height", low=0.01, high=2.0))
        slope.done()


def _spot(top: _Table, key: str, with_yaw: bool) -> Spot:
    if not top.has(key):
        top.take(key, None)
        return Spot()
    spot = _Table(f"{top.where}: {key}", top.take(key))
    at, area = spot.numbers("at", "x, y", None), spot.area(default=None)
    yaw = spot.number("yaw_deg") if with_yaw and spot.has("yaw_deg") else None
    spot.done()
    if (at is None) == (area is None):
        raise ValueError(f"{spot.where}: expected either at = [x, y] or area = [x_min, y_min, x_max, y_max]")
    return Spot(None if at is None else (at[0], at[1]), None if yaw is None else math.radians(yaw), area)


def _crowd(top: _Table) -> tuple[CrowdLine, ...]:
    value = top.take("crowd", [])
    lines = []
    for k, entry in enumerate(value if isinstance(value, list) else [value], start=1):
        line = _Table(f"{top.where}: crowd" + (f" {k}" if isinstance(value, list) else ""), entry)
        people = line.whole("people")
        if not 0 <= people <= 500:
            raise line.wrong("people", people, "0 to 500")
        speed = line.numbers("speed", "mean, standard deviation", (1.3, 0.26))
        if speed[0] <= 0 or speed[1] < 0:
            raise line.wrong("speed", list(speed), "[mean, standard deviation] in m/s, mean above 0")
        kind, area = line.choice("kind", KINDS, "wandering"), line.area(default=None)
        if kind == "talking" and people == 1:
            raise line.wrong("people", people, "2 or more who talk")
        if kind == "wandering" and area is not None:
            raise line.wrong("area", list(area), "none: wanderers go everywhere")
        line.done()
        lines.append(CrowdLine(people, kind, (speed[0], speed[1]), area))
    return tuple(lines)


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and not math.isnan(value)
