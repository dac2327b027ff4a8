"""Rays against triangle meshes beside MuJoCo's and PyBullet's, in furnished rooms that are meshes themselves."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("mujoco")
pytest.importorskip("pybullet")

from mesh_shapes import ball, chair, scanned_room
from test_other_engines import DEFAULT, MOUNTED, check, compare_worlds

from densecavoid.frames import Command
from densecavoid.scenarios.free_space import free_points
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.mesh import Mesh
from densecavoid.sim.people import WANDERING
from densecavoid.sim.spec import Crowd, WorldSpec
from densecavoid.sim.world import SimConfig, Simulator
from peers.ray_engines import MujocoRays

ROOM = scanned_room()
THINGS = chair(), Mesh.wedge(1.2, 0.8, 0.7), ball(0.3, 0.4), Mesh.box(0.6, 0.4, 1.1)


class ScannedRoom:
    """A scanned room with chairs, ramps and other meshes, a box, a pillar and people between them."""

    name = "scanned-room"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        plan, area = FloorPlan(), (-3.4, -3.4, 3.4, 3.4)
        plan.mesh(ROOM, 0.0, 0.0, rng.uniform(-0.02, 0.02))
        for i, (x, y) in enumerate(free_points(rng, plan, area, 9, 0.5, apart_m=1.1)):
            plan.mesh(THINGS[i % len(THINGS)], float(x), float(y), rng.uniform(-3, 3), rng.choice([0.0, 0.0, 0.25]))
        (box_x, box_y), (pillar_x, pillar_y) = free_points(rng, plan, area, 2, 0.4, apart_m=0.8).tolist()
        plan.box(box_x, box_y, 0.4, 0.3, rng.uniform(-3, 3))
        plan.pillar(pillar_x, pillar_y, 0.15)
        start, goal = free_points(rng, plan, area, 2, 0.35)
        pos = free_points(rng, plan, area, 5, 0.35, apart_m=0.7, away_from=(start[0], start[1]), away_m=0.8)
        people = Crowd.draw(rng, pos, free_points(rng, plan, area, 5, 0.35), 0.8, 0.2, WANDERING, area)
        return WorldSpec(self.name, plan, (start[0], start[1], rng.uniform(-3, 3)), (goal[0], goal[1]), people)


def scene(seed: int, config: SimConfig) -> Simulator:
    sim = Simulator(ScannedRoom(), 1, config)
    sim.reset(np.array([seed]))
    for _ in range(4):
        sim.step(Command(np.full(1, 0.2, np.float32), np.full(1, 0.4, np.float32)))
    return sim


@pytest.mark.parametrize("config", [DEFAULT, MOUNTED], ids=["default", "mounted"])
def test_rays_agree_with_mujoco_and_pybullet_on_meshes(config):
    assert len(ROOM.faces) >= 20_000
    check(compare_worlds(scene(seed, config) for seed in range(2)))


@pytest.mark.slow
@pytest.mark.parametrize("config", [DEFAULT, MOUNTED], ids=["default", "mounted"])
def test_rays_agree_with_mujoco_and_pybullet_on_meshes_in_forty_scenes(config):
    check(compare_worlds(scene(seed, config) for seed in range(100, 120)))


def test_meshes_stand_in_the_exported_world_where_they_do_here():
    """MuJoCo moves a mesh to its own centre and axes, and must move its geom back."""
    plan = FloorPlan()
    plan.mesh(THINGS[1], 1.5, -2.0, 0.7, 0.1)
    plan.mesh(THINGS[1], -1.5, 2.0, -0.7, 0.0)
    model = MujocoRays(plan, np.zeros((0, 4, 5))).model
    assert model.nmesh == 1
    names = [model.geom(i).name for i in range(model.ngeom)]
    for place, name in zip(plan.meshes, ("mesh-0", "mesh-1"), strict=True):
        geom = names.index(name)
        w, x, y, z = model.geom_quat[geom]
        turn = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        theirs = model.mesh_vert[: model.mesh_vertnum[0]] @ turn.T + model.geom_pos[geom]
        cos, sin = np.cos(place.yaw), np.sin(place.yaw)
        ours = place.mesh.vertices @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + [place.x, place.y, place.z]
        np.testing.assert_allclose(np.sort(theirs, axis=0), np.sort(ours, axis=0), atol=1e-5)
