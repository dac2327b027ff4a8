"""Floor plans in TOML: what is written stands where it says, and what is wrong is named."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from densecavoid.scenarios import make_scenario
from densecavoid.scenarios.free_space import clear_path
from densecavoid.scenarios.plan_file import read_plan
from densecavoid.sim.clearance import clearances_m
from densecavoid.sim.people import STANDING, WANDERING
from densecavoid.sim.world import SimConfig, Simulator

OFFICE = Path(__file__).parents[2] / "examples" / "office.toml"


def write(folder: Path, text: str) -> Path:
    path = folder / "house.toml"
    path.write_text(text)
    return path


ROOMS = """
crowd = { people = 6, speed = [1.0, 0.2], kind = "wandering" }
[[room]]
area = [0.0, 0.0, 6.0, 5.0]
[[room]]
area = [6.1, 0.0, 12.0, 5.0]
material = "concrete"
[[door]]
at = [6.05, 2.0]
width = 1.0
"""


def test_a_door_opens_both_walls_between_two_rooms(tmp_path):
    plan = read_plan(write(tmp_path, ROOMS)).floor_plan
    area = (0.0, 0.0, 12.0, 5.0)
    path = clear_path(plan, (1.0, 1.0), (11.0, 4.0), area, 0.4, 0.05)
    assert path is not None
    at_wall = path[np.abs(path[:, 0] - 6.05) < 0.04]
    assert np.abs(at_wall[:, 1] - 2.0).max() < 0.11
    # the jambs are half a metre either side of the door's middle
    np.testing.assert_allclose(clearances_m(plan, np.array([[6.05, 2.0]])), 0.5, atol=1e-6)
    closed = read_plan(write(tmp_path, ROOMS.split("[[door]]")[0])).floor_plan
    assert clear_path(closed, (1.0, 1.0), (11.0, 4.0), area, 0.4, 0.05) is None


def test_everything_stands_where_it_says(tmp_path):
    plan = read_plan(
        write(
            tmp_path,
            """
            ceiling = inf
            goal = { at = [8.0, 0.0] }
            [[wall]]
            line = [0.0, 2.0, 10.0, 2.0]
            thickness = 0.2
            material = "glass"
            [[box]]
            at = [1.0, -1.0]
            size = [2.0, 0.5]
            yaw_deg = 90
            z = [0.5, 0.8]
            material = "metal"
            [[pillar]]
            at = [3.0, -1.0]
            radius = 0.3
            [[kerb]]
            line = [0.0, -3.0, 10.0, -3.0]
            height = 0.1
            [[furniture]]
            kind = "plant"
            at = [5.0, -1.5]
            """,
        )
    ).floor_plan
    assert math.isinf(plan.ceiling_m)
    np.testing.assert_allclose(plan.boxes[0], [5.0, 2.0, 0.0, 5.1, 0.1, 0.0, 2.5])
    np.testing.assert_allclose(plan.boxes[1], [1.0, -1.0, math.pi / 2, 1.0, 0.25, 0.5, 0.8])
    assert plan.box_materials[:2] == ["glass", "metal"]
    np.testing.assert_allclose(plan.cylinders[0], [3.0, -1.0, 0.3, 0.0, 2.5])
    assert plan.cylinder_materials == ["concrete", "plastic", "plant"]
    np.testing.assert_allclose(plan.boxes[2][[1, 5, 6]], [-3.0, 0.0, 0.1])


def test_start_and_goal_are_fixed_or_drawn_from_an_area(tmp_path):
    text = ROOMS + "[start]\nat = [1.0, 1.0]\nyaw_deg = 90\n[goal]\narea = [8.0, 1.0, 11.0, 4.0]\n"
    building = read_plan(write(tmp_path, text))
    goals = set()
    for seed in range(5):
        spec = building.spawn(np.random.default_rng(seed))
        assert spec.start_pose == pytest.approx((1.0, 1.0, math.pi / 2))
        assert 8.0 <= spec.goal[0] <= 11.0 and 1.0 <= spec.goal[1] <= 4.0
        goals.add(spec.goal)
    assert len(goals) == 5


def test_the_crowd_is_one_line(tmp_path):
    spec = read_plan(write(tmp_path, ROOMS)).spawn(np.random.default_rng(0))
    assert spec.crowd.size == 6 and (spec.crowd.behaviour == WANDERING).all()
    lines = """crowd = [
        { people = 4, speed = [0.5, 0.0] },
        { people = 5, kind = "talking", area = [0.5, 0.5, 5.5, 4.5] },
        { people = 2, kind = "standing", area = [7.0, 0.5, 11.0, 4.5] },
    ]"""
    several = ROOMS.replace('crowd = { people = 6, speed = [1.0, 0.2], kind = "wandering" }', lines)
    crowd = read_plan(write(tmp_path, several)).spawn(np.random.default_rng(1)).crowd
    standing, walking = crowd.behaviour == STANDING, crowd.behaviour == WANDERING
    assert standing.sum() == 7 and walking.sum() == 4
    np.testing.assert_allclose(crowd.preferred_speed[walking], 0.5)
    assert crowd.group is not None
    alone = standing & (crowd.group == -1)
    assert alone.sum() == 2 and (crowd.pos[alone, 0] > 6.5).all()
    assert (crowd.pos[standing & (crowd.group >= 0), 0] < 6.0).all()
    nobody = ROOMS.replace("people = 6", "people = 0")
    assert read_plan(write(tmp_path, nobody)).spawn(np.random.default_rng(0)).crowd.size == 0


def test_a_ros_map_may_be_the_walls(tmp_path):
    from PIL import Image

    pixels = np.full((100, 160), 255, np.uint8)
    pixels[:2] = pixels[-2:] = pixels[:, :2] = pixels[:, -2:] = 0
    Image.fromarray(pixels).save(tmp_path / "m.pgm")
    yaml = "image: m.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    (tmp_path / "m.yaml").write_text(yaml)
    building = read_plan(write(tmp_path, 'map = "m.yaml"\n[[furniture]]\nkind = "sofa"\nat = [4.0, 2.5]\n'))
    spec = building.spawn(np.random.default_rng(0))
    assert len(spec.floor_plan.boxes) == 4 + 4
    assert 0 < spec.start_pose[0] < 8 and 0 < spec.goal[1] < 5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("walls = 3", r"house\.toml: walls = 3 is not known, expected one of: ceiling, map, room, wall, door"),
        ("[[room]]\narea = [0, 0, 5]", r"room 1: area is \[0, 0, 5\], expected numbers \[x_min, y_min, x_max, y_max\]"),
        ("[[room]]\narea = [5, 0, 0, 5]", r"room 1: area is .*x_min < x_max"),
        ('[[room]]\narea = [0, 0, 5, 5]\ncolour = "red"', r"room 1: colour = 'red' is not known"),
        ("[[wall]]\nline = [0, 0, 0, 0]", r"wall 1: line is .*two different ends"),
        ('[[wall]]\nline = [0, 0, 1, 0]\nmaterial = "cheese"', r"wall 1: material is 'cheese', expected one of"),
        ("[[pillar]]\nat = [0, 0]", r"pillar 1: radius is missing"),
        ("[[pillar]]\nat = [0, 0]\nradius = -1", r"pillar 1: radius is -1, expected a number in \[0\.001"),
        ('[[furniture]]\nkind = "piano"\nat = [0, 0]', r"furniture 1: kind is 'piano', expected one of: table, chair"),
        ('[[furniture]]\nkind = "desk"\nat = "here"', r"furniture 1: at is 'here', expected numbers \[x, y\]"),
        ("[[kerb]]\nline = [0, 0, 1, 0]\nheight = 0.5", r"kerb 1: height is 0\.5, .*in \[0\.01, 0\.2\]"),
        (ROOMS + "[[door]]\nat = [3.0, 3.0]", r"door 2: at is \[3\.0, 3\.0\], expected a point on a wall"),
        (ROOMS + "[[door]]\nat = [6.05, 2.5]", r"door 2: at is .* clear of other doors"),
        ("crowd = { people = 2.5 }", r"crowd: people is 2\.5, expected a whole number"),
        ("crowd = { people = -1 }", r"crowd: people is -1, expected 0 to 500"),
        ('crowd = { people = 3, kind = "dancing" }', r"crowd: kind is 'dancing', expected one of: wandering"),
        ("crowd = { people = 3, speed = 1.0 }", r"crowd: speed is 1\.0, expected numbers \[mean, standard deviation\]"),
        ("crowd = [{ people = 3 }, 4]", r"crowd 2 is 4, expected a table"),
        ("start = { at = [0, 0], area = [0, 0, 1, 1] }", r"start: expected either at"),
        ('map = "missing.yaml"', r"map is 'missing\.yaml', expected a map\.yaml beside house\.toml"),
        ("ceiling = 0", r"ceiling is 0, expected a number in \[0\.1, inf\]"),
        ("ceiling = [", r"house\.toml: is no TOML"),
        ("distance = [5, 2]", r"distance is \[5\.0, 2\.0\]"),
    ],
)
def test_what_is_wrong_is_named_by_file_key_and_value(tmp_path, text, message):
    with pytest.raises(ValueError, match=message):
        read_plan(write(tmp_path, text))


def test_unreachable_and_blocked_ends_are_refused(tmp_path):
    closed = ROOMS.split("[[door]]")[0] + "[start]\nat = [1.0, 1.0]\n[goal]\nat = [11.0, 4.0]\n"
    with pytest.raises(ValueError, match=r"plan:house\.toml: no way of 0\.38 m clearance from start"):
        read_plan(write(tmp_path, closed))
    blocked = ROOMS + "[start]\nat = [1.0, 1.0]\n[goal]\nat = [6.05, 4.0]\n"
    with pytest.raises(ValueError, match=r"no way of"):
        read_plan(write(tmp_path, blocked))
    with pytest.raises(ValueError, match=r"no room for 400 walkers"):
        read_plan(write(tmp_path, ROOMS.replace("people = 6", "people = 400"))).spawn(np.random.default_rng(0))
    with pytest.raises(ValueError, match=r"no file nowhere\.toml"):
        make_scenario("plan:nowhere.toml")


def test_an_edited_plan_is_read_again(tmp_path):
    import os

    path = write(tmp_path, ROOMS)
    assert make_scenario(f"plan:{path}").spawn(np.random.default_rng(0)).crowd.size == 6
    path.write_text(ROOMS.replace("people = 6", "people = 3"))
    os.utime(path, ns=(1, 1))
    assert make_scenario(f"plan:{path}").spawn(np.random.default_rng(0)).crowd.size == 3


def test_the_example_office_runs_and_its_people_reach_every_room():
    scenario = make_scenario(f"plan:{OFFICE}")
    simulator = Simulator(scenario, 4, SimConfig(threads=1))
    for first in range(0, 12, 4):
        simulator.reset(first + np.arange(4))
    assert (simulator.people().active.sum(axis=1) == 24).all()
    net = scenario.spawn(np.random.default_rng(0)).crowd.net
    assert net is not None
    rooms = {"west": (0, 8.6, 5, 14), "middle": (5.1, 8.6, 10, 14), "east": (10.1, 8.6, 15, 14)}
    rooms |= {"meeting": (15.1, 8.6, 24, 14), "kitchen": (16.05, 0, 20.4, 6.1), "store": (20.6, 0, 24, 6.1)}
    for x0, y0, x1, y1 in rooms.values():
        inside = (net.places[:, 0] > x0) & (net.places[:, 0] < x1) & (net.places[:, 1] > y0) & (net.places[:, 1] < y1)
        assert inside.any()
    assert simulator.bytes_per_world <= 64 * 1024


def test_a_mesh_from_a_file_stands_where_the_plan_says(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box((1000.0, 600.0, 500.0)).export(tmp_path / "crate.stl")
    (tmp_path / "hall.toml").write_text(
        """
        [[room]]
        area = [0.0, 0.0, 8.0, 6.0]
        [[mesh]]
        file = "crate.stl"
        at = [4.0, 3.0]
        z = 0.25
        scale = 0.001
        """
    )
    spec = read_plan(tmp_path / "hall.toml").spawn(np.random.default_rng(0))
    points = np.array([[4.0, 2.0], [2.5, 3.0]])
    np.testing.assert_allclose(clearances_m(spec.floor_plan, points), [0.7, 1.0], atol=1e-5)
    (tmp_path / "hall.toml").write_text('[[mesh]]\nfile = "none.stl"\nat = [0.0, 0.0]\n')
    with pytest.raises(ValueError, match=r"hall.toml: mesh 1: mesh file is '.*none.stl', expected a file that exists"):
        read_plan(tmp_path / "hall.toml")
