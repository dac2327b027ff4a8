"""The second body is the same world: what it senses, where its robot goes, and what it calls a collision, against the
project's simulator and by hand."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

pytest.importorskip("mujoco")

from densecavoid.frames import CameraConfig, Command, LidarConfig, SensorFrame
from densecavoid.robot.mujoco_world import MujocoWorld
from densecavoid.scenarios import make_scenario
from densecavoid.sim.config import SimConfig
from densecavoid.sim.crowds.recording import Recording
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import STANDING
from densecavoid.sim.spec import Crowd, Replay, Scenario, WorldSpec
from densecavoid.sim.world import Simulator

CLEAN = SimConfig(threads=1)
MOUNTED = SimConfig(
    threads=1,
    lidar=LidarConfig(mount_x_m=0.12, mount_height_m=0.35, mount_pitch_rad=0.12),
    camera=CameraConfig(mount_x_m=-0.1, mount_height_m=1.1, mount_pitch_rad=0.35, min_range_m=0.3),
)
TOLERANCE_M = 2e-3


@dataclass(frozen=True)
class Only:
    """A scenario of one world."""

    spec: WorldSpec
    name: str = "only"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return self.spec


def command(linear: float, angular: float) -> Command:
    return Command(np.array([linear], np.float32), np.array([angular], np.float32))


def both(scenario: Scenario, seed: int, config: SimConfig = CLEAN) -> tuple[Simulator, MujocoWorld]:
    """The same world twice."""
    simulator = Simulator(scenario, 1, config)
    simulator.reset(np.array([seed]))
    return simulator, MujocoWorld(scenario, seed, config)


def share_that_agrees(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Of values that are the same within the tolerance, or missing in both; rays that graze an edge may differ."""
    assert ours.shape == theirs.shape and ours.dtype == theirs.dtype
    missing = ~np.isfinite(ours) & ~np.isfinite(theirs)
    with np.errstate(invalid="ignore"):
        return float((missing | (np.abs(ours - theirs) < TOLERANCE_M)).mean())


def check_frames(ours: SensorFrame, theirs: SensorFrame) -> None:
    assert share_that_agrees(ours.scan_m, theirs.scan_m) >= 0.995
    assert share_that_agrees(ours.depth_m, theirs.depth_m) >= 0.995
    np.testing.assert_allclose(theirs.odom_pose, ours.odom_pose, atol=1e-4)
    np.testing.assert_array_equal(theirs.velocity, ours.velocity)
    np.testing.assert_array_equal(theirs.goal_odom, ours.goal_odom)
    np.testing.assert_allclose(theirs.time_s, ours.time_s, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "config"),
    [("dense-ped", CLEAN), ("random-sparse-ped", CLEAN), ("dense-static", CLEAN), ("dense-static", MOUNTED)],
    ids=["people", "people who change their minds", "furniture", "other mounts"],
)
def test_senses_what_the_simulator_senses_along_the_same_way(name: str, config: SimConfig) -> None:
    simulator, world = both(make_scenario(name), 5, config)
    rng, steps, seen = np.random.default_rng(0), 0, []
    while steps < 40 and not simulator.done[0]:
        if steps % 8 == 0:
            frame = world.sense()
            check_frames(simulator.sense(), frame)
            seen.append([np.isfinite(frame.scan_m).mean(), np.isfinite(frame.depth_m).mean()])
        drive = command(rng.uniform(0.0, 0.4), rng.uniform(-0.4, 0.4))
        simulator.step(drive)
        world.step(drive)
        steps += 1
    assert steps >= 8
    assert (np.mean(seen, axis=0) > 0.1).all()
    assert bool(world.outcome) == bool(simulator.done[0])


def test_sees_the_ground_and_people_where_no_wall_is() -> None:
    plan = FloorPlan()
    for y in (-2.0, 2.0):
        plan.wall(0.0, y, 6.0, y)
    for start in ((9.0, 0.0, 0.3), (-5.0, 8.0, 0.3), (3.0, 0.0, 0.3)):
        crowd = replace(one_person(0.25), pos=np.array([[start[0] + 3.0, start[1] + 0.5]]))
        simulator, world = both(Only(WorldSpec("beside", plan, start, (50.0, 0.0), crowd=crowd)), 0)
        check_frames(simulator.sense(), world.sense())
        assert np.isfinite(world.sense().depth_m).mean() > 0.2


def test_drives_an_arc_as_by_hand_and_keeps_the_robots_limits() -> None:
    world = MujocoWorld(Only(WorldSpec("arc", FloorPlan(), (1.0, 2.0, 0.5), (50.0, 0.0))), 0, CLEAN)
    for _ in range(30):
        world.step(command(7.0, 9.0))  # 1 m/s and .4 rad/s are the most
    turned, radius = 0.4 * 3.0, 1.0 / 0.4
    x = 1.0 + radius * (math.sin(0.5 + turned) - math.sin(0.5))
    y = 2.0 - radius * (math.cos(0.5 + turned) - math.cos(0.5))
    np.testing.assert_allclose(world.robot_pose, [x, y, 0.5 + turned], atol=1e-4)
    assert world.velocity == pytest.approx((1.0, 0.4))
    world.step(command(-3.0, 0.0))
    np.testing.assert_allclose(world.robot_pose[:2], [x, y], atol=1e-4)  # it does not reverse
    with pytest.raises(ValueError, match="finite"):
        world.step(command(math.nan, 0.0))


def until_the_end(world: MujocoWorld) -> float:
    """Straight on at .1 m/s: where along x it ended."""
    for _ in range(1000):
        world.step(command(0.1, 0.0))
        if world.outcome:
            return float(world.robot_pose[0])
    raise AssertionError("it goes on and on")


def one_person(radius: float) -> Crowd:
    """Who stands at x = 2 and looks at the robot."""
    place, one = np.array([[2.0, 0.0]]), np.ones(1)
    return Crowd(place, place, 0 * one, radius * one, 1.7 * one, np.array([STANDING]), heading_rad=np.array([math.pi]))


def test_a_person_is_hit_where_the_body_comes_within_30_cm() -> None:
    spec = WorldSpec("person", FloorPlan(), (1.2, 0.0, 0.0), (9.0, 0.0), crowd=one_person(0.25))
    world = MujocoWorld(Only(spec), 0, CLEAN)
    # The halves of the trunk: discs of .55 r, .15 r to either side of the body's axis (sim/people.py).
    distance = math.sqrt((0.30 + 0.55 * 0.25) ** 2 - (0.15 * 0.25) ** 2)
    end = until_the_end(world)
    assert (world.outcome, world.collided_with) == ("collision", "person-0")
    assert 2.0 - distance <= end + 1e-6 and end - 1e-6 <= 2.0 - distance + 0.1 * CLEAN.physics_dt_s
    before = world.time_s
    world.step(command(0.1, 0.0))
    assert world.time_s == before  # an ended episode stays as it ended


def test_the_contact_rule_is_narrower() -> None:
    spec = WorldSpec(
        "contact", FloorPlan(), (1.2, 0.0, 0.0), (9.0, 0.0), crowd=one_person(0.25), collision_distance_m=0.18
    )
    distance = math.sqrt((0.18 + 0.55 * 0.25) ** 2 - (0.15 * 0.25) ** 2)
    assert until_the_end(MujocoWorld(Only(spec), 0, CLEAN)) == pytest.approx(2.0 - distance, abs=0.006)


def test_a_table_top_is_hit_what_hangs_higher_is_not_and_glass_is_hit_unseen() -> None:
    plan = FloorPlan()
    plan.box(1.0, 0.0, 0.2, 2.0, z_min=0.85, z_max=1.5)
    plan.box(2.0, 0.0, 0.2, 2.0, z_min=0.74, z_max=0.78)
    plan.box(1.5, 3.0, 4.0, 0.1, z_max=2.0, material="glass")
    spec = WorldSpec("things", plan, (0.0, 0.0, 0.0), (9.0, 0.0))
    world = MujocoWorld(Only(spec), 0, CLEAN)
    end = until_the_end(world)
    assert end == pytest.approx(1.9 - 0.30, abs=0.006)
    assert (world.outcome, world.collided_with) == ("collision", "box-1")
    simulator, beside_glass = both(Only(replace(spec, start_pose=(1.5, 2.6, math.pi / 2))), 0)
    np.testing.assert_array_equal(beside_glass.sense().scan_m, simulator.sense().scan_m)
    assert np.isinf(beside_glass.sense().scan_m).all()
    beside_glass.step(command(1.0, 0.0))
    assert (beside_glass.outcome, beside_glass.collided_with) == ("collision", "box-2")


def test_ends_at_the_goal_and_when_time_is_up() -> None:
    spec = WorldSpec("goal", FloorPlan(), (0.0, 0.0, 0.0), (1.0, 0.0), time_limit_s=4.0)
    world = MujocoWorld(Only(replace(spec, time_limit_s=60.0)), 0, CLEAN)
    assert until_the_end(world) == pytest.approx(0.7, abs=0.006)
    assert world.outcome == "success"
    world = MujocoWorld(Only(spec), 0, CLEAN)
    assert until_the_end(world) == pytest.approx(0.4, abs=0.001)
    assert (world.outcome, world.time_s) == ("timeout", pytest.approx(4.0))


def test_recorded_people_of_other_sizes_take_the_places_of_those_who_left() -> None:
    """One slot: first somebody slight, then somebody large whom bounds of the first one would hide."""
    steps, dt = 60, CLEAN.physics_dt_s
    state = np.tile(np.array([2.0, 0.0, 0.0, 0.0], np.float32), (steps, 1))
    recording = Recording(
        dt_s=dt,
        frame_start=np.arange(steps + 1, dtype=np.int32),
        state_w=state,
        person=(np.arange(steps) >= 20).astype(np.int32),
        height_m=np.array([1.5, 1.95], np.float32),
        radius_m=np.array([0.19, 0.33], np.float32),
        file_id=np.array([1, 2]),
    )
    spec = WorldSpec("two", FloorPlan(), (0.0, 0.0, 0.0), (9.0, 0.0), replay=Replay(recording, 0.0))
    simulator, world = both(Only(spec), 0)
    widths = []
    for _ in range(16):
        ours, theirs = simulator.sense(), world.sense()
        widths.append(np.isfinite(theirs.scan_m[0]).sum())
        np.testing.assert_allclose(theirs.scan_m, ours.scan_m, atol=TOLERANCE_M)
        assert share_that_agrees(ours.depth_m, theirs.depth_m) >= 0.999
        simulator.step(command(0.0, 0.0))
        world.step(command(0.0, 0.0))
    assert widths[-1] > widths[0] > 0


def test_refuses_what_it_has_not() -> None:
    scenario = make_scenario("dense-ped")
    for name, config in {
        "sensors": SimConfig(sensors="real"),
        "dynamics": SimConfig(dynamics="dynamic"),
        "people": SimConfig(people="reactive"),
    }.items():
        with pytest.raises(ValueError, match=f"SimConfig.{name}"):
            MujocoWorld(scenario, 0, config)
    with pytest.raises(ValueError, match="LidarConfig"):
        MujocoWorld(scenario, 0, SimConfig(lidar=LidarConfig(latency_s=0.1)))
    with pytest.raises(ValueError, match="do not react"):
        MujocoWorld(make_scenario("robot-freezing:0.5-1.0"), 0)
