"""Furniture: what the lidar at .26 m and the camera at .40 m see of each piece, and that its size is what it says."""

from __future__ import annotations

import math

import numpy as np
import pytest

from densecavoid.frames import CameraConfig, LidarConfig
from densecavoid.scenarios.free_space import FOR_PEOPLE, clearances_m
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.furniture import PIECES, kerb, place, ramp
from densecavoid.sim.spec import WorldSpec
from densecavoid.sim.world import SimConfig, Simulator


class OneWorld:
    name = "one"

    def __init__(self, plan: FloorPlan) -> None:
        self.spec = WorldSpec("one", plan, (0.0, 0.0, 0.0), (0.0, 3.0))

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return self.spec


def seen(plan: FloorPlan) -> tuple[float, float]:
    """Nearest range of the lidar and nearest depth of the camera from (0, 0), looking along x."""
    lidar = LidarConfig(num_rays=721, fov_rad=math.radians(60))
    camera = CameraConfig(width=160, height=120, min_range_m=0.5)
    simulator = Simulator(OneWorld(plan), 1, SimConfig(lidar=lidar, camera=camera, threads=1))
    simulator.reset(np.zeros(1, np.int64))
    frame = simulator.sense()
    ground = 0.40 / math.tan(camera.fov_vertical_rad / 2)  # nearer than this the camera sees no floor
    depth = frame.depth_m[0]
    above = np.where(camera.row_slopes[:, None] * depth > -0.395, depth, np.nan)  # without the floor
    assert ground < 1.0
    return float(frame.scan_m.min()), float(np.nanmin(above, initial=np.inf))


def test_a_kerb_and_a_trolleys_deck_are_under_the_lidar_and_in_the_cameras_sight():
    plan = FloorPlan(ceiling_m=math.inf)
    kerb(plan, 2.0, -2.0, 2.0, 2.0, height=0.12)
    scan, depth = seen(plan)
    assert math.isinf(scan)
    assert depth == pytest.approx(2.0 - 0.075, abs=0.02)
    plan = FloorPlan(ceiling_m=math.inf)
    place(plan, "trolley", 2.5, 0.0, math.pi)  # its deck begins at x = 2, its handle is at x = 3
    scan, depth = seen(plan)
    assert scan > 2.9
    assert depth == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize(
    ("kind", "scan_m", "depth_m"),
    [  # facing away from the sensor or towards it, 2.5 m ahead: nearest thing at each height
        ("shelf", 2.5 - 0.175, 2.5 - 0.175),
        ("sofa", 2.5 - 0.45, 2.5 - 0.45),
        ("desk", 2.5 - 0.35, 2.5 - 0.40),  # side panels, and the top
        ("bench", 2.5 - 0.20, 2.5 - 0.225),  # feet, and the seat
        ("counter", 2.5 - 0.35, 2.5 - 0.35),  # its closed back
        ("plant", 2.5 - 0.20, 2.5 - 0.32),  # pot, and leaves
        ("planter", 2.5 - 0.30, 2.5 - 0.30),
        ("bin", 2.5 - 0.22, 2.5 - 0.22),
    ],
)
def test_what_lidar_and_camera_see_of_a_piece(kind, scan_m, depth_m):
    plan = FloorPlan(ceiling_m=math.inf)
    place(plan, kind, 2.5, 0.0, 0.0)
    scan, depth = seen(plan)
    assert scan == pytest.approx(scan_m, abs=0.05) or scan == pytest.approx(math.hypot(scan_m, 0.78), abs=0.08)
    assert depth == pytest.approx(depth_m, abs=0.03)


@pytest.mark.parametrize("kind", list(PIECES))
def test_a_piece_fills_the_floor_it_says_and_turns_with_its_yaw(kind):
    piece = PIECES[kind]
    for yaw in (0.0, 0.9):
        plan = FloorPlan()
        piece.build(plan, 1.0, -2.0, yaw)
        low_things = [row for row in plan.boxes if row[5] < 2.0]
        corners = []
        for x, y, box_yaw, half_length, half_width, _, _ in low_things:
            for a in (-1, 1):
                for b in (-1, 1):
                    dx = a * half_length * math.cos(box_yaw) - b * half_width * math.sin(box_yaw)
                    dy = a * half_length * math.sin(box_yaw) + b * half_width * math.cos(box_yaw)
                    corners.append((x + dx - 1.0, y + dy + 2.0))
        for x, y, radius, bottom, _ in plan.cylinders:
            if bottom < 2.0:
                angles = np.linspace(0, 2 * math.pi, 720)
                corners += [(x + radius * math.cos(t) - 1.0, y + radius * math.sin(t) + 2.0) for t in angles]
        points = np.array(corners) @ np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
        size = points.max(axis=0) - points.min(axis=0)
        np.testing.assert_allclose(size, [piece.depth_m, piece.width_m], atol=0.025)
        assert len(plan.box_materials) + len(plan.cylinder_materials) > 0


def test_people_step_over_kerbs_and_ramps_and_walk_under_trees_and_lintels():
    plan = FloorPlan()
    kerb(plan, 0.0, -2.0, 0.0, 2.0)
    ramp(plan, 3.0, 0.0, 2.0, 1.0, 0.0, 0.15)
    place(plan, "tree", 6.0, 0.0)
    plan.wall(10.0, -2.0, 10.0, 2.0, doors=[(2.0, 1.0)])
    points = np.array([[0.0, 0.0], [3.0, 0.0], [7.0, 0.0], [10.0, 0.0]])
    np.testing.assert_allclose(clearances_m(plan, points, 0.4, FOR_PEOPLE), 0.4)
    assert (clearances_m(plan, points)[:2] <= 0).all()  # the robot cannot


def test_a_ramp_rises_to_its_height():
    plan = FloorPlan()
    ramp(plan, 0.0, 0.0, 2.0, 1.0, 0.0, 0.16, steps=8)
    assert plan.boxes[:, 6].tolist() == pytest.approx([0.01 + 0.02 * k for k in range(8)])
    assert plan.boxes[:, 0].tolist() == pytest.approx([-0.875 + 0.25 * k for k in range(8)])


def test_walls_with_doors_by_hand():
    plan = FloorPlan()
    plan.wall(0.0, 0.0, 4.0, 0.0, doors=[(3.0, 1.0), (1.0, 0.8)])
    solid = sorted((row[0] - row[3], row[0] + row[3]) for row in plan.boxes if row[5] == 0.0)
    lintels = sorted((row[0] - row[3], row[0] + row[3]) for row in plan.boxes if row[5] > 0.0)
    np.testing.assert_allclose(solid, [(-0.05, 0.6), (1.4, 2.5), (3.5, 4.05)])
    np.testing.assert_allclose(lintels, [(0.6, 1.4), (2.5, 3.5)])
    with pytest.raises(ValueError, match=r"door \(distance, width\) is \(3\.9, 1\.0\)"):
        plan.wall(0.0, 0.0, 4.0, 0.0, doors=[(3.9, 1.0)])
    with pytest.raises(ValueError, match="clear of other doors"):
        plan.wall(0.0, 0.0, 4.0, 0.0, doors=[(1.0, 1.0), (1.5, 1.0)])


def test_unknown_furniture_and_high_kerbs_are_refused():
    with pytest.raises(ValueError, match="unknown furniture 'piano', expected one of: table, chair"):
        place(FloorPlan(), "piano", 0.0, 0.0)
    with pytest.raises(ValueError, match=r"kerb height is 0\.3"):
        kerb(FloorPlan(), 0.0, 0.0, 1.0, 0.0, 0.3)


def test_a_copy_grows_by_itself_and_a_crop_keeps_what_reaches_in():
    plan = FloorPlan()
    plan.box(0.0, 0.0, 2.0, 2.0)
    plan.box(10.0, 0.0, 1.0, 1.0, material="metal")
    plan.pillar(5.0, 0.0, 0.5)
    assert plan.packed() is plan.packed()
    twin = plan.copy()
    twin.box(1.0, 1.0, 1.0, 1.0)
    assert (len(plan.boxes), len(twin.boxes)) == (2, 3)
    assert (len(plan.packed().boxes), len(twin.packed().boxes)) == (2, 3)
    part = plan.cropped(4.0, -1.0, 9.6, 1.0)
    assert part.box_materials == ["metal"] and len(part.cylinders) == 1 and len(part.packed().boxes) == 1
