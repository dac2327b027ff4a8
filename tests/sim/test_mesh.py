"""Triangle meshes: what is admitted, what rays see of them, and that robot and people meet the same surfaces."""

from __future__ import annotations

import importlib
import math

import numpy as np
import pytest
from mesh_shapes import ball, chair, scanned_room

from densecavoid.frames import CameraConfig, Command
from densecavoid.scenarios.free_space import clear_path, free_points
from densecavoid.sim.clearance import clearances_m
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.mesh import Mesh, load_mesh, mesh_set, place_rows
from densecavoid.sim.mesh_contact import GROUND_M, lessen_by_meshes
from densecavoid.sim.mesh_rays import mesh_depth, mesh_scan, triangle_of_hit
from densecavoid.sim.people import TRAVERSING, WANDERING
from densecavoid.sim.spec import Crowd, WorldSpec
from densecavoid.sim.world import SimConfig, Simulator
from densecavoid.viz.scene import extent_of

NO_STARTS = np.empty(0, np.float32)
ROBOT_TOP_M = SimConfig().robot.height_m


class Given:
    """A scenario that deals out given worlds, one for each seed."""

    name = "given"

    def __init__(self, *specs: WorldSpec) -> None:
        self.specs = specs

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return self.specs[rng.integers(len(self.specs))]


def world(plan: FloorPlan, start=(0.0, 0.0, 0.0), **kwargs) -> WorldSpec:
    return WorldSpec("given", plan, start, (50.0, 0.0), **kwargs)


def simulate(plan: FloorPlan, config: SimConfig | None = None, **kwargs) -> Simulator:
    sim = Simulator(Given(world(plan, **kwargs)), 1, config or SimConfig(threads=1))
    sim.reset(np.zeros(1, np.int64))
    return sim


def random_plan(rng: np.random.Generator, meshes: tuple[Mesh, ...], count: int) -> FloorPlan:
    plan = FloorPlan()
    for _ in range(count):
        x, y = rng.uniform(-3, 3, 2)
        z = rng.choice([0.0, 0.0, 0.3, -0.1])
        plan.mesh(meshes[rng.integers(len(meshes))], float(x), float(y), rng.uniform(-3, 3), float(z))
    return plan


def packed(plan: FloorPlan):
    """Placed meshes and their set, for the kernels."""
    meshes = tuple(dict.fromkeys(place.mesh for place in plan.meshes))
    return place_rows(plan.meshes, [meshes.index(place.mesh) for place in plan.meshes]), mesh_set(meshes)


def world_triangles(plan: FloorPlan) -> np.ndarray:
    """Corners [T, 3, 3] of all placed meshes in the world frame, in the order in which hits are numbered."""
    parts = []
    for mesh, x, y, z, yaw in plan.meshes:
        turn = np.array([[math.cos(yaw), math.sin(yaw), 0], [-math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])
        parts.append(mesh.triangles.astype(np.float64) @ turn + [x, y, z])
    return np.concatenate(parts)


def slow_rays(starts: np.ndarray, directions: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest hit of each ray [R, 3] among all triangles, each pair by itself (Moeller, Trumbore, J. Graphics Tools
    1997), in float64: distances and triangles."""
    edge_1, edge_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    distance, triangle = np.full(len(starts), np.inf), np.full(len(starts), -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        for r, (start, direction) in enumerate(zip(starts, directions, strict=True)):
            p = np.cross(direction, edge_2)
            inverse = 1.0 / (edge_1 * p).sum(axis=1)
            rel = start - corners[:, 0]
            u, q = (rel * p).sum(axis=1) * inverse, np.cross(rel, edge_1)
            v, t = (q @ direction) * inverse, (edge_2 * q).sum(axis=1) * inverse
            t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)
            triangle[r], distance[r] = t.argmin(), t.min()
    return distance, np.where(np.isfinite(distance), triangle, -1)


def apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Difference of distances; 0 where both are infinite."""
    return np.abs(np.minimum(a, 1e6) - np.minimum(b, 1e6))


# -- loading -----------------------------------------------------------------------------------------------------------


def sorted_corners(mesh: Mesh) -> np.ndarray:
    """Triangles in an order that does not depend on how they are stored, each from its least corner on."""
    rows = []
    for triangle in np.round(mesh.triangles.astype(np.float64), 5).tolist():
        k = triangle.index(min(triangle))
        rows.append(triangle[k:] + triangle[:k])
    return np.array(sorted(rows))


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "glb"])
def test_a_mesh_is_the_same_from_every_kind_of_file(tmp_path, suffix):
    trimesh = pytest.importorskip("trimesh")
    shape = chair()
    path = tmp_path / f"chair.{suffix}"
    trimesh.Trimesh(1000.0 * shape.vertices.astype(float), shape.faces, process=False).export(path)
    read = load_mesh(path, scale=0.001, material="fabric")
    np.testing.assert_allclose(sorted_corners(read), sorted_corners(shape), atol=2e-5)
    assert read.solid and read.material == "fabric" and read.name == f"chair.{suffix}"


def test_a_file_with_y_up_is_turned_upright(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    shape = Mesh.wedge(2.0, 1.0, 0.5)
    x, y, z = shape.vertices.astype(float).T
    trimesh.Trimesh(np.stack([x, z, -y], axis=1), shape.faces, process=False).export(tmp_path / "ramp.obj")
    np.testing.assert_allclose(
        sorted_corners(load_mesh(tmp_path / "ramp.obj", up="y")), sorted_corners(shape), atol=1e-5
    )


def test_a_file_wound_inside_out_in_places_becomes_solid(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    shape = Mesh.box(1.0, 1.0, 1.0)
    faces = shape.faces.copy()
    faces[3] = faces[3, ::-1]
    trimesh.Trimesh(shape.vertices, faces, process=False).export(tmp_path / "box.ply")
    assert load_mesh(tmp_path / "box.ply").solid
    with pytest.raises(ValueError, match=r"wound differently.* 3\b"):
        Mesh.from_triangles(shape.vertices.astype(float), faces)


def test_the_missing_extra_is_named(tmp_path, monkeypatch):
    (tmp_path / "a.obj").write_text("v 0 0 0\n")
    real = importlib.import_module

    def without(name, *args):
        if name == "trimesh":
            raise ModuleNotFoundError(name)
        return real(name, *args)

    monkeypatch.setattr(importlib, "import_module", without)
    with pytest.raises(ModuleNotFoundError, match=r"densecavoid\[mesh\]"):
        load_mesh(tmp_path / "a.obj")


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "a file that exists"), ("nonsense", "triangles|cannot be read"), ("v 0 0 0\nv 1 0 0\n", "triangles|read")],
)
def test_files_that_are_no_meshes_are_refused(tmp_path, content, message):
    pytest.importorskip("trimesh")
    path = tmp_path / "odd.obj"
    if content is not None:
        path.write_text(content)
    with pytest.raises(ValueError, match=message):
        load_mesh(path)


CUBE = Mesh.box(1.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("vertices", "faces", "kwargs", "message"),
    [
        (CUBE.vertices, CUBE.faces[:-1], {}, "open edges.* 3.*allow_open=True"),
        (CUBE.vertices, CUBE.faces[:0], {}, "triangles.* 0.*at least one"),
        (np.where(CUBE.vertices > 0.9, np.nan, CUBE.vertices), CUBE.faces, {}, "vertex.*nan.*finite"),
        (2e3 * CUBE.vertices, CUBE.faces, {}, "2000 m.*is it in metres"),
        (0 * CUBE.vertices, CUBE.faces, {}, "degenerate"),
        (CUBE.vertices[:, [0, 0, 0]], CUBE.faces, {}, "degenerate"),
        (CUBE.vertices, CUBE.faces + 1, {}, "vertex numbers"),
        (CUBE.vertices, np.tile(CUBE.faces, (200_000, 1)), {}, "2400000.*simplify"),
        (CUBE.vertices, CUBE.faces, {"material": "cheese"}, "cheese"),
        (CUBE.vertices, CUBE.faces, {"material": "glass"}, "see-through"),
    ],
)
def test_meshes_that_make_no_sense_are_refused(vertices, faces, kwargs, message):
    with pytest.raises(ValueError, match=message):
        Mesh.from_triangles(vertices.astype(np.float64), faces.astype(np.int64), **kwargs)


def test_open_meshes_are_admitted_when_asked_for_and_have_no_inside():
    lidless = Mesh.from_triangles(CUBE.vertices.astype(np.float64), CUBE.faces[:-1].astype(np.int64), allow_open=True)
    assert not lidless.solid and len(lidless.faces) == 11
    assert CUBE.solid


@pytest.mark.parametrize("shape", [CUBE, chair(), scanned_room(20)], ids=["cube", "chair", "room"])
def test_every_triangle_is_in_one_leaf_and_in_all_boxes_around_it(shape):
    low, high, skip, first, count = shape.hierarchy
    covered = np.concatenate([np.arange(f, f + n) for f, n in zip(first, count, strict=True) if n])
    np.testing.assert_array_equal(np.sort(covered), np.arange(len(shape.faces)))
    for node in range(len(skip)):
        leaves = [k for k in range(node, skip[node]) if count[k]]
        inside = np.concatenate([shape.triangles[first[k] : first[k] + count[k]] for k in leaves]).reshape(-1, 3)
        np.testing.assert_array_equal(inside.min(axis=0), low[node])
        np.testing.assert_array_equal(inside.max(axis=0), high[node])


@pytest.mark.parametrize("values", [(math.nan, 0.0, 0.0, 0.0), (0.0, 0.0, math.inf, 0.0)])
def test_meshes_stand_at_finite_places(values):
    with pytest.raises(ValueError, match="finite"):
        FloorPlan().mesh(CUBE, *values)


# -- rays --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pitch", [0.0, 0.25])
def test_a_box_of_triangles_is_seen_as_a_box(pitch):
    config = SimConfig(threads=1, camera=CameraConfig(mount_pitch_rad=pitch))
    meshes, boxes = FloorPlan(), FloorPlan()
    for x, y, yaw, height in ((2.5, 0.3, 0.4, 0.5), (1.9, -0.9, 1.0, 0.3), (3.9, 0.5, 0.2, 1.5), (0.8, 0.1, 0.2, 0.2)):
        meshes.mesh(Mesh.box(1.0, 0.6, height), x, y, yaw)
        boxes.box(x, y, 1.0, 0.6, yaw, 0.0, height)
    for plan in (meshes, boxes):
        plan.pillar(1.6, 0.4, 0.1)
    ours, theirs = simulate(meshes, config).sense(), simulate(boxes, config).sense()
    assert np.isfinite(ours.scan_m).sum() > 50 and np.isfinite(ours.depth_m).sum() > 1000
    for a, b in ((ours.scan_m, theirs.scan_m), (ours.depth_m, theirs.depth_m)):
        same = np.isclose(a, b, atol=1e-5, rtol=0, equal_nan=True)
        assert (~same).sum() <= 3  # float32 may decide otherwise right at an edge


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("moving", [False, True], ids=["still", "moving"])
def test_pitched_and_moving_scans_agree_with_a_slow_loop(seed, moving):
    rng = np.random.default_rng(seed)
    plan = random_plan(rng, (chair(), Mesh.wedge(1.2, 0.8, 0.9), ball(0.4, 0.5), scanned_room(12)), 6)
    places, meshes = packed(plan)
    x, y, z, yaw, pitch = *rng.uniform(-1, 1, 2), 0.26, rng.uniform(-3, 3), 0.3 * (seed % 2)
    turned = rng.uniform(-0.2, 0.2) if moving else 0.0  # while the sweep lasts
    bearing = np.linspace(-math.pi, math.pi, 360) if seed % 2 else np.linspace(-2.1, 2.1, 360)
    sweep = np.linspace(0, 1, 360)
    directions = np.stack([np.cos(bearing) * math.cos(pitch), np.sin(bearing), -np.cos(bearing) * math.sin(pitch)], 1)
    cos, sin = np.cos(turned * sweep), np.sin(turned * sweep)
    rotate = np.array([[cos, -sin, 0 * cos], [sin, cos, 0 * cos], [0 * cos, 0 * cos, 1 + 0 * cos]]).transpose(2, 0, 1)
    directions = np.einsum("rij,rj->ri", rotate, directions)
    starts = np.stack([0.1 * sweep, 0.03 * sweep], axis=1) if moving else np.zeros((360, 2))
    ranges, hits = np.full(360, np.inf, np.float32), np.full(360, -7, np.int32)
    shift = starts.astype(np.float32).T.copy() if moving else (NO_STARTS, NO_STARTS)
    mesh_scan(ranges, hits, 100, x, y, z, yaw, *directions.astype(np.float32).T.copy(), *shift, 4.0, places, meshes)

    turn = np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])
    start_w = np.array([x, y, z]) + np.column_stack([starts, np.zeros(360)]) @ turn.T
    slow, triangle = slow_rays(start_w, directions @ turn.T, world_triangles(plan))
    seen = (slow < 4.0) & (ranges < 4.0)
    assert seen.sum() > 40
    assert ((slow < 3.999) & (ranges > 4.0)).sum() <= 1
    assert (apart(ranges, slow)[seen] < 1e-4).mean() > 0.99
    exact = seen & (apart(ranges, slow) < 1e-6)
    assert (hits[exact] - 100 == triangle[exact]).mean() > 0.98  # a ray on an edge belongs to either
    assert (hits[np.isinf(ranges)] == -7).all()


@pytest.mark.parametrize("seed", range(4))
def test_pitched_images_agree_with_a_slow_loop_and_say_what_they_show(seed):
    rng = np.random.default_rng(seed)
    plan = random_plan(rng, (chair(), Mesh.wedge(1.2, 0.8, 0.9), ball(0.4, 0.5), scanned_room(12)), 6)
    places, meshes = packed(plan)
    x, y, z, yaw, pitch = *rng.uniform(-1, 1, 2), 0.4, rng.uniform(-3, 3), (0.0, 0.4, -0.3, 0.2)[seed]
    camera = CameraConfig(width=32, height=24)
    image, hits = np.full((24, 32), np.inf, np.float32), np.full((24, 32), -7, np.int32)
    column, row = camera.column_slopes, camera.row_slopes
    optics = column.astype(np.float32), row.astype(np.float32), pitch
    mesh_depth(image, hits, 5, x, y, z, yaw, *optics, 5.0, places, meshes)

    left, up = np.meshgrid(column, row)
    forward, rise = math.cos(pitch) + up * math.sin(pitch), up * math.cos(pitch) - math.sin(pitch)
    rays = np.stack(
        [forward * math.cos(yaw) - left * math.sin(yaw), forward * math.sin(yaw) + left * math.cos(yaw), rise]
    )
    slow, triangle = slow_rays(np.tile([x, y, z], (768, 1)), rays.reshape(3, -1).T, world_triangles(plan))
    slow, triangle = slow.reshape(24, 32), triangle.reshape(24, 32)
    near = slow < 5.0
    assert near.sum() > 100
    assert (apart(image, slow)[near] < 1e-4).mean() > 0.995
    assert (hits[near] - 5 == triangle[near]).mean() > 0.97
    first = np.cumsum([0] + [len(place.mesh.faces) for place in plan.meshes])
    for number in np.unique(hits[near]) - 5:
        m, index = triangle_of_hit(number, places, meshes)
        np.testing.assert_array_equal(meshes.corners[index], plan.meshes[m].mesh.triangles[number - first[m]])


def test_what_lies_below_the_cameras_least_range_hides_what_is_behind_it():
    plan = FloorPlan()
    plan.mesh(Mesh.box(0.1, 0.5, 0.9), 1.0, 0.0)
    plan.box(3.0, 0.0, 0.2, 4.0, z_max=2.0)
    depth = simulate(plan).sense().depth_m[0]
    assert np.isnan(depth[20:40, 35:45]).all()
    assert depth[20:35, 0] == pytest.approx(np.full(15, 2.9), abs=1e-4)


# -- contact -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(12))
def test_rays_and_collisions_find_the_same_nearest_surface(seed):
    rng = np.random.default_rng(seed)
    shapes = chair(), Mesh.wedge(1.2, 0.8, 1.1), Mesh.box(0.7, 0.3, 0.6), ball(0.4, 0.7), ball(0.3, 0.2)
    plan = random_plan(rng, shapes, 5)
    if seed % 3 == 0:
        plan.mesh(scanned_room(16), 0.0, 0.0)
    places, meshes = packed(plan)
    sim = simulate(plan, start=(30.0, 30.0, 0.0))
    points = rng.uniform(-3, 3, (12, 2))
    contact = sim.nearest_surface_m(0, points)
    count = 1440
    angles = np.arange(count) * 2 * math.pi / count - math.pi
    directions = [f(angles).astype(np.float32) for f in (np.cos, np.sin, np.zeros_like)]
    hits = np.empty(count, np.int32)
    heights = np.concatenate([[GROUND_M + 1e-5], np.linspace(0.03, ROBOT_TOP_M - 0.01, 78), [ROBOT_TOP_M - 1e-5]])
    compared = 0
    for point, distance in zip(points, contact, strict=True):
        ranges = np.full(count, np.inf, np.float32)
        for z in heights:
            mesh_scan(ranges, hits, 0, *point, z, 0.0, *directions, NO_STARTS, NO_STARTS, 12.0, places, meshes)
        nearest = float(ranges.min())
        if distance > 0.0:
            assert distance - 1e-4 <= nearest <= distance + 0.01 + 0.005 * distance, (point, distance, nearest)
            compared += 1
    assert compared >= 5


def test_boxes_of_triangles_collide_as_boxes():
    plan, boxes, rng = FloorPlan(), FloorPlan(), np.random.default_rng(3)
    for height in (0.5, 2.0):  # lower and higher than the robot
        x, y, yaw = rng.uniform(-1, 3, 3)
        plan.mesh(Mesh.box(1.0, 0.6, height), x, y, yaw)
        boxes.box(x, y, 1.0, 0.6, yaw, 0.0, height)
    points = rng.uniform(-2, 4, (2000, 2))
    ours, theirs = (simulate(each, start=(30.0, 30.0, 0.0)).nearest_surface_m(0, points) for each in (plan, boxes))
    assert (theirs < 0).sum() > 20
    np.testing.assert_allclose(ours, np.maximum(theirs, 0.0), atol=1e-6)


def test_inside_below_and_above_are_told_apart_by_hand():
    plan = FloorPlan()
    plan.mesh(chair(), 0.0, 5.0)  # under the seat: in the way of a robot of .8 m
    plan.mesh(Mesh.box(1.0, 1.0, 0.5), 0.0, 10.0, z=0.9)  # a shelf above the robot
    plan.mesh(Mesh.box(1.0, 1.0, 0.015), 0.0, 15.0)  # a mat
    plan.mesh(Mesh.box(1.0, 1.0, 3.0), 0.0, 20.0)  # inside of a block higher than the robot
    plan.mesh(Mesh.wedge(2.0, 1.0, 1.0), 0.0, 25.0)  # its surface at x = .5 is at .75 m, at x = -.99 below the ground's
    inverted = Mesh.box(4.0, 4.0, 2.5)
    room = Mesh.from_triangles(inverted.vertices.astype(np.float64), inverted.faces[:, ::-1].astype(np.int64))
    plan.mesh(room, 0.0, 30.0)  # a room modelled from inside: its walls 2 m from the middle
    y = np.array([5.0, 10.0, 15.0, 20.0, 25.0, 25.0, 30.0])
    points = np.stack([[0.0, 0.0, 0.0, 0.0, 0.5, -0.985, 0.3], y], axis=1)
    distance = simulate(plan).nearest_surface_m(0, points)
    expected = [0.0, 2.0 + 25.0 - 10.0 - 2.5, 2.0, 0.0, 0.0, 0.025, 1.7]
    expected[1] = math.hypot(0.0, 5.0 - 0.22)  # to the chair
    expected[2] = 20.0 - 15.0 - 0.5  # to the block
    np.testing.assert_allclose(distance, expected, atol=1e-5)


def test_a_robot_stops_at_a_mesh_where_it_stops_at_a_box():
    meshes, boxes = FloorPlan(), FloorPlan()
    meshes.mesh(Mesh.box(1.0, 2.0, 0.5), 2.0, 0.0)
    boxes.box(2.0, 0.0, 1.0, 2.0, z_max=0.5)
    ends = []
    for plan in (meshes, boxes):
        sim = simulate(plan)
        while not sim.done[0]:
            sim.step(Command(np.full(1, 0.7, np.float32), np.zeros(1, np.float32)))
        assert sim.collided[0] and sim.collided_person[0] == -1
        ends.append((*sim.robot_pose[0], sim.clearance_m[0], sim.time_s[0]))
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-6)


def test_starts_goals_and_ways_keep_clear_of_meshes():
    plan, area = FloorPlan(), (-3.0, -3.0, 3.0, 3.0)
    plan.room(*area)
    plan.mesh(Mesh.box(0.4, 4.0, 1.2), 0.0, -1.0)  # from the lower wall to y = 1
    boxes = FloorPlan()
    boxes.room(*area)
    boxes.box(0.0, -1.0, 0.4, 4.0, z_max=1.2)
    points = np.random.default_rng(0).uniform(-3, 3, (300, 2))
    np.testing.assert_allclose(clearances_m(plan, points), np.maximum(clearances_m(boxes, points), 0.0), atol=1e-6)
    for point in free_points(np.random.default_rng(1), plan, area, 40, 0.3):
        assert clearances_m(boxes, point[None])[0] >= 0.3 - 1e-6
    way = clear_path(plan, (-1.5, -2.0), (1.5, -2.0), area, 0.3)
    assert way is not None and way[:, 1].max() > 1.2


def crowd(rng: np.random.Generator, count: int, area) -> Crowd:
    pos = np.column_stack([np.linspace(-2.6, 2.6, count), np.full(count, -2.4)])
    goal = np.column_stack([rng.uniform(-2.6, 2.6, count), np.full(count, 2.4)])
    return Crowd.draw(rng, pos, goal, 1.0, 0.2, WANDERING, area, 0.2)


@pytest.mark.parametrize("seed", range(3))
def test_nobody_walks_through_a_mesh(seed):
    rng = np.random.default_rng(seed)
    plan, blocks, area = FloorPlan(), FloorPlan(), (-2.6, -2.6, 2.6, 2.6)
    plan.room(-3, -3, 3, 3)
    for x, y in ((-1.6, 0.0), (0.0, 0.4), (1.6, -0.2)):
        yaw = rng.uniform(-3, 3)
        plan.mesh(Mesh.box(0.8, 0.5, 1.2), x, y, yaw)
        blocks.box(x, y, 0.8, 0.5, yaw)
    sim = simulate(
        plan, start=(-2.5, 2.5, 0.0), crowd=crowd(rng, 8, area), time_limit_s=100.0, collision_distance_m=1e-6
    )
    walked, before = np.zeros(8), sim.people().pos_w[0].copy()
    for _ in range(300):
        sim.step(Command(np.zeros(1, np.float32), np.zeros(1, np.float32)))
        people = sim.people()
        walked += np.hypot(*(people.pos_w[0] - before).T)
        before = people.pos_w[0].copy()
        into = clearances_m(blocks, people.pos_w[0].astype(np.float64)) - people.radius_m[0]
        assert into.min() > -1e-4
    assert walked.min() > 3.0  # they did walk


def test_who_gets_into_a_mesh_gets_out_again():
    plan = FloorPlan()
    plan.mesh(Mesh.box(1.0, 1.0, 2.5), 0.0, 3.0)
    rng = np.random.default_rng(0)
    person = Crowd.draw(rng, np.array([[2.0, 3.0]]), np.array([[0.0, 8.0]]), 1.0, 0.1, TRAVERSING)
    sim = simulate(plan, crowd=person)
    sim._state.pos[0, 0] = 0.1, 3.2
    for _ in range(5):
        sim.step(Command(np.zeros(1, np.float32), np.zeros(1, np.float32)))
    x, y = sim.people().pos_w[0, 0]
    assert max(abs(x), abs(y - 3.0)) > 0.5 + sim.people().radius_m[0, 0] - 1e-3 and math.hypot(x, y - 3.0) < 2.5


@pytest.mark.parametrize("who", ["start", "goal", "person"])
def test_nobody_may_begin_inside_of_a_mesh(who):
    place = {"start": (0.0, 0.0), "goal": (50.0, 0.0), "person": (5.0, 5.0)}[who]
    crowd = Crowd.draw(np.random.default_rng(0), np.array([[5.0, 5.0]]), np.zeros((1, 2)), 1.0, 0.1, WANDERING)
    plan = FloorPlan()
    plan.mesh(Mesh.box(1.0, 1.0, 3.0), place[0] + 0.1, place[1])
    with pytest.raises(ValueError, match=rf"given: .*{who}.* 0.00 m from the nearest thing"):
        simulate(plan, crowd=crowd)


# -- the simulator -----------------------------------------------------------------------------------------------------


def mixed_worlds() -> Given:
    """Worlds of which some have meshes, some none, with people."""
    rng = np.random.default_rng(5)
    specs = []
    for i in range(4):
        plan = random_plan(rng, (chair(), ball(0.4, 0.5)), 4 * (i % 2))
        plan.room(-4, -4, 4, 4)
        people = crowd(rng, 6, (-2.6, -2.6, 2.6, 2.6))
        specs.append(world(plan, start=(-3.0, 3.0, -0.7), crowd=people, collision_distance_m=1e-6))
    return Given(*specs)


def test_real_sensors_lose_black_meshes_and_see_light_ones():
    """A surface's material and its turn decide as they do for boxes: the same world of both gives the same returns."""
    frames = []
    for kind in ("mesh", "box"):
        plan = FloorPlan()
        for y, material in ((0.5, "black"), (-0.5, "plaster")):
            if kind == "mesh":
                plan.mesh(Mesh.box(0.4, 0.9, 1.2, material=material), 2.8, y, 0.3)
            else:
                plan.box(2.8, y, 0.4, 0.9, 0.3, 0.0, 1.2, material)
        frames.append(simulate(plan, SimConfig(threads=1, sensors="real")).sense())
    for mesh, box in ((frames[0].scan_m, frames[1].scan_m), (frames[0].depth_m, frames[1].depth_m)):
        assert (np.isfinite(mesh) == np.isfinite(box)).mean() > 0.995
        assert np.isclose(mesh, box, atol=1e-3, equal_nan=True).mean() > 0.98
    half = frames[0].depth_m.shape[2] // 2
    nearer = (frames[0].depth_m[0, :30] < 3.0).reshape(30, 2, half).sum(axis=(0, 2))
    assert nearer[0] < 0.2 * nearer[1]


def test_images_show_meshes_in_their_colour():
    plan = FloorPlan()
    plan.mesh(Mesh.box(0.4, 1.0, 1.0, material="fabric"), 2.5, 0.0, 0.2)
    boxes = FloorPlan()
    boxes.box(2.5, 0.0, 0.4, 1.0, 0.2, 0.0, 1.0, "fabric")
    ours, theirs = (simulate(each).images() for each in (plan, boxes))
    assert (ours.segmentation == theirs.segmentation).mean() > 0.999
    assert (np.abs(ours.rgb.astype(int) - theirs.rgb).max(axis=-1) <= 2).mean() > 0.999
    assert len(np.unique(ours.rgb[0, 25:35, 35:45].reshape(-1, 3), axis=0)) < 20


def run(scenario: Given, seeds: list[int], threads: int) -> list[np.ndarray]:
    sim = Simulator(scenario, len(seeds), SimConfig(threads=threads, sensors="real"))
    sim.reset(np.array(seeds))
    for _ in range(10):
        sim.step(Command(np.full(len(seeds), 0.3, np.float32), np.full(len(seeds), 0.1, np.float32)))
    frame = sim.sense()
    return [frame.scan_m, frame.depth_m, sim.robot_pose, sim.people().pos_w, sim.clearance_m]


def test_same_seed_same_bits_for_any_threads_and_batch():
    scenario, seeds = mixed_worlds(), [1, 2, 3, 4, 5, 6]
    together = run(scenario, seeds, 1)
    for value, again in zip(together, run(scenario, seeds, 3), strict=True):
        np.testing.assert_array_equal(value, again)
    for b, seed in enumerate(seeds):
        for value, alone in zip(together, run(scenario, [seed], 1), strict=True):
            np.testing.assert_array_equal(value[b], alone[0])


def test_a_saved_simulator_goes_on_with_its_meshes():
    scenario = mixed_worlds()
    sim = Simulator(scenario, 4, SimConfig(threads=1))
    sim.reset(np.array([1, 2, 3, 4]))
    saved = sim.state_dict()
    assert saved["num_meshes"].max() == 4
    other = Simulator(scenario, 4, SimConfig(threads=1))
    with pytest.raises(ValueError, match="saved mesh"):
        other.load_state_dict(saved)
    other.reset(np.array([1, 2, 3, 4]))
    for _ in range(3):
        other.step(Command(np.ones(4, np.float32), np.ones(4, np.float32)))
    other.load_state_dict(saved)
    frames = sim.sense(), other.sense()
    np.testing.assert_array_equal(frames[0].scan_m, frames[1].scan_m)
    np.testing.assert_array_equal(frames[0].depth_m, frames[1].depth_m)


def test_meshes_come_back_in_the_floor_plan_and_in_pictures():
    shape, plan = chair(), FloorPlan()
    plan.mesh(shape, 1.0, 2.0, 0.5, 0.1)
    back = simulate(plan).floor_plan(0)
    assert back.meshes[0].mesh is shape
    assert back.meshes[0][1:] == pytest.approx((1.0, 2.0, 0.1, 0.5))
    extent = extent_of(plan, np.array([1.0, 2.0]), np.array([1.0, 2.0]))
    assert extent.low_w[0] <= 1.0 - 0.22 and extent.high_w[1] >= 2.0 + 0.22


def test_distances_stop_at_the_limit():
    plan = FloorPlan()
    plan.mesh(CUBE, 10.0, 0.0)
    clearances = np.array([3.0, 20.0])
    lessen_by_meshes(plan.meshes, np.zeros((2, 2)), 0.0, 1.9, clearances)
    np.testing.assert_allclose(clearances, [3.0, 9.5])
