"""Scenarios in the user's own building: `map:FILE[:PEOPLE]` and `plan:FILE`."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from densecavoid.scenarios.building import Building, CrowdLine
from densecavoid.scenarios.plan_file import read_plan
from densecavoid.scenarios.ros_map import read_ros_map
from densecavoid.sim.floorplan import FloorPlan

_PEOPLE = 10
_MOST_PEOPLE = 500


def own_building(name: str) -> Building:
    """The scenario that `map:FILE[:PEOPLE]` or `plan:FILE` names.

    Raises:
        ValueError: if the file is missing or wrong, saying where, or there is no free space in it.
        OSError: if a file cannot be read.
    """
    kind, _, rest = name.partition(":")
    if not rest:
        form = "map:FILE[:PEOPLE]" if kind == "map" else "plan:FILE"
        raise ValueError(f"scenario {name!r} is incomplete, expected {form}")
    if kind == "plan":
        return _plan(Path(rest), _changed(Path(rest)))
    file, _, last = rest.rpartition(":")
    people = _PEOPLE
    if file and last.lstrip("-").isdigit():
        rest, people = file, int(last)
    if not 0 <= people <= _MOST_PEOPLE:
        raise ValueError(f"scenario {name!r} has {people} people, expected 0 to {_MOST_PEOPLE}")
    path = Path(rest)
    if not path.is_file():
        raise ValueError(f"map: no file {path}, expected a map.yaml as map_server reads it")
    return _map(path, people, _changed(path))


def _changed(path: Path) -> int:
    """So that a file that was edited is read again."""
    return path.stat().st_mtime_ns if path.is_file() else 0


@lru_cache(maxsize=4)
def _plan(path: Path, changed: int) -> Building:
    return read_plan(path)


@lru_cache(maxsize=4)
def _map(path: Path, people: int, changed: int) -> Building:
    ros_map = read_ros_map(path)
    if not ros_map.free.any():
        raise ValueError(f"{path}: has no free cell, expected places to be")
    plan = FloorPlan()
    ros_map.add_walls(plan)
    crowd = (CrowdLine(people, "wandering", (1.3, 0.26)),)
    return Building(f"map:{path.name}" + ("" if people == _PEOPLE else f":{people}"), plan, ros_map, crowd=crowd)
