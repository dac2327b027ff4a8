"""Worlds that cannot begin are refused by scenario, who and where; those that just can are not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from densecavoid.scenarios import make_scenario, names
from densecavoid.sim.clearance import check_can_begin, clearances_m, nearest_pair
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.mesh import Mesh
from densecavoid.sim.people import STANDING
from densecavoid.sim.spec import Appearance, Crowd, WalkNet, WorldSpec
from densecavoid.sim.world import SimConfig, Simulator


class OneWorld:
    name = "house"

    def __init__(self, spec: WorldSpec) -> None:
        self.spec = spec

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return self.spec


def begin(plan: FloorPlan | None = None, crowd: Crowd | None = None, **kwargs) -> None:
    spec = WorldSpec(
        **{
            "scenario": "house",
            "floor_plan": plan or FloorPlan(),
            "start_pose": (0.0, 0.0, 0.0),
            "goal": (5.0, 0.0),
            "crowd": crowd or Crowd.nobody(),
            **kwargs,
        }
    )
    Simulator(OneWorld(spec), 1).reset(np.zeros(1, np.int64))


def people(*places: tuple[float, float], radius: float = 0.25) -> Crowd:
    pos, one = np.array(places), np.ones(len(places))
    return Crowd(pos, pos, 0.5 * one, radius * one, 1.7 * one, np.full(len(places), STANDING))


def wall_at(x: float, z_min: float = 0.0, z_max: float = 2.5) -> FloorPlan:
    plan = FloorPlan()
    plan.box(x + 0.05, 0.0, 0.1, 6.0, z_min=z_min, z_max=z_max)  # its face at x
    return plan


def test_a_start_or_goal_without_room_is_refused():
    with pytest.raises(ValueError, match=r"house: the robot's start at \(0\.00, 0\.00\) is 0\.29 m .* at least 0\.3 m"):
        begin(wall_at(0.29))
    with pytest.raises(ValueError, match=r"house: the robot's start at .* is -0\.05 m from"):
        begin(wall_at(-0.05))
    with pytest.raises(ValueError, match=r"house: the robot's goal at \(5\.00, 0\.00\) is 0\.20 m"):
        begin(wall_at(5.2))
    begin(wall_at(0.30))
    begin(wall_at(5.31))
    begin(wall_at(0.2), collision_distance_m=0.18)  # the contact rule


def test_what_is_overhead_is_no_hindrance_and_what_is_low_is_one_to_the_robot_alone():
    begin(wall_at(0.0, z_min=0.9))
    with pytest.raises(ValueError, match="the robot's start"):
        begin(wall_at(0.0, z_max=0.12))
    begin(wall_at(3.0, z_max=0.12), people((3.0, 0.0)))
    begin(wall_at(3.0, z_min=2.1), people((3.0, 0.0)))
    with pytest.raises(ValueError, match=r"house: person 0 at \(3\.00, 0\.00\)"):
        begin(wall_at(3.0, z_max=0.45), people((3.0, 0.0)))


def test_people_in_walls_pillars_each_other_or_the_robot_are_refused():
    with pytest.raises(ValueError, match=r"house: person 1 at \(2\.80, 1\.00\) is 0\.20 m .* radius, 0\.25 m"):
        begin(wall_at(3.0), people((1.5, 0.0), (2.8, 1.0)))
    pillar = FloorPlan()
    pillar.pillar(2.0, 2.0, 0.3)
    with pytest.raises(ValueError, match=r"person 0 at \(2\.10, 2\.00\) is -0\.20 m"):
        begin(pillar, people((2.1, 2.0)))
    with pytest.raises(
        ValueError, match=r"house: persons 0 at \(2\.00, 0\.00\) and 2 at \(2\.00, 0\.40\) overlap by 0\.10"
    ):
        begin(None, people((2.0, 0.0), (4.0, 1.0), (2.0, 0.4)))
    begin(None, people((2.0, 0.0), (2.4, 0.0)))  # behind one another there is room
    with pytest.raises(ValueError, match=r"house: person 0 at \(0\.50, 0\.00\) is 0\.25 m from the robot's start"):
        begin(None, people((0.5, 0.0)))
    begin(wall_at(3.0), people((2.75, 1.0), (2.25, 1.0), (0.56, 0.0)))


def test_people_who_appear_later_need_room_beside_each_other_alone():
    line = people((0.0, -0.3), (0.0, 0.3))
    begin(wall_at(2.0), line, appearance=Appearance(3.0, 1.0))
    with pytest.raises(ValueError, match=r"persons 0 at .* overlap"):
        begin(wall_at(2.0), people((0.0, 0.0), (0.0, 0.3)), appearance=Appearance(3.0, 1.0))


def test_a_refused_world_leaves_the_others_as_they_were():
    good, bad = make_scenario("dense-ped"), OneWorld(WorldSpec("house", wall_at(0.0), (0.0, 0.0, 0.0), (5.0, 0.0)))
    simulator = Simulator(good, 2)
    simulator.reset(np.arange(2))
    before = simulator.people().pos_w.copy()
    simulator.scenario = bad
    with pytest.raises(ValueError, match="house"):
        simulator.reset(np.arange(2), np.array([False, True]))
    np.testing.assert_array_equal(simulator.people().pos_w, before)


def test_a_scenario_without_room_is_named():
    class Full:
        name = "full-house"

        def spawn(self, rng: np.random.Generator) -> WorldSpec:
            raise ValueError("no room for 3 places")

    with pytest.raises(ValueError, match=r"^full-house: no room for 3 places$"):
        Simulator(Full(), 1).reset(np.zeros(1, np.int64))


@pytest.mark.parametrize("name", names())
def test_every_scenario_passes_over_many_seeds(name):
    simulator = Simulator(make_scenario(name), 1, SimConfig(threads=1))
    for seed in range(40):
        simulator.reset(np.array([10_000 + seed]))


@pytest.mark.slow
@pytest.mark.parametrize("name", names())
def test_every_scenario_passes_over_hundreds_of_seeds(name):
    simulator = Simulator(make_scenario(name), 1, SimConfig(threads=1))
    for seed in range(300):
        simulator.reset(np.array([20_000 + seed]))


def test_clearances_against_a_slow_loop():
    rng = np.random.default_rng(0)
    plan = FloorPlan()
    for _ in range(30):
        x, y = rng.uniform(-5, 5, 2)
        length, width = rng.uniform(0.2, 2.0, 2)
        plan.box(x, y, length, width, rng.uniform(-3, 3), 0.0, rng.uniform(0.1, 2.0))
        x, y = rng.uniform(-5, 5, 2)
        plan.pillar(x, y, rng.uniform(0.1, 0.5), 0.0, rng.uniform(0.1, 2.0))
    points = rng.uniform(-6, 6, (100, 2))
    found = clearances_m(plan, points, heights=(0.5, 2.0))
    for point, clear in zip(points, found, strict=True):
        least = math.inf
        for x, y, yaw, half_length, half_width, _, top in plan.boxes:
            along = abs(math.cos(yaw) * (point[0] - x) + math.sin(yaw) * (point[1] - y)) - half_length
            across = abs(math.cos(yaw) * (point[1] - y) - math.sin(yaw) * (point[0] - x)) - half_width
            outside = math.hypot(max(along, 0), max(across, 0)) or max(along, across)
            least = min(least, outside if top > 0.5 else math.inf)
        for x, y, radius, _, top in plan.cylinders:
            least = min(least, math.dist(point, (x, y)) - radius if top > 0.5 else math.inf)
        assert clear == pytest.approx(least, abs=1e-5)


def test_nearest_pair_by_hand():
    # Seen from above a body of half width .25 is .5 m wide and 2 x .55 x .25 = .275 m deep.
    pos, radius = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.6]]), np.full(3, 0.25)
    gap, first, second = nearest_pair(pos, radius, np.zeros(3))  # side by side, the last two
    assert (gap, first, second) == (pytest.approx(0.1), 1, 2)
    gap, first, second = nearest_pair(pos, radius, np.full(3, math.pi / 2))  # the last two behind one another
    assert (gap, first, second) == (pytest.approx(0.325), 1, 2)
    assert nearest_pair(np.zeros((1, 2)), np.full(1, 0.25), np.zeros(1)) == (math.inf, -1, -1)


def test_a_start_inside_a_mesh_is_refused():
    plan = FloorPlan()
    plan.mesh(Mesh.box(1.0, 1.0, 0.5), 3.0, 0.0)
    with pytest.raises(ValueError, match=r"given: the robot's goal at \(3\.00, 0\.00\) is 0\.00 m from"):
        check_can_begin(WorldSpec("given", plan, (0.0, 0.0, 0.0), (3.0, 0.0)), 0.8)


def test_a_wrong_net_is_refused():
    places, links = np.array([[0.0, 0.0, 0.1], [1.0, 0.0, 0.1]]), np.array([[1], [0]])
    WalkNet(places, links)
    with pytest.raises(ValueError, match="expected -1 or a place below 2"):
        WalkNet(places, np.array([[2], [0]]))
    with pytest.raises(ValueError, match="one or more a place"):
        WalkNet(places, np.array([[-1], [0]]))
    with pytest.raises(ValueError, match="'1 places', expected 2 to 64"):
        WalkNet(places[:1], links[:1])
    one = people((3.0, 0.0))
    with pytest.raises(ValueError, match=r"Crowd\.leg .* given with a net"):
        Crowd(one.pos, one.goal, one.preferred_speed, one.radius_m, one.height_m, one.behaviour, leg=np.array([[0, 1]]))
