"""Speed of sensing triangle meshes beside MuJoCo's rays on the same meshes, one thread each.

python benchmarks/meshes.py [--json FILE] [--seconds 1]
"""

from __future__ import annotations

import argparse
import json
import math
from functools import partial
from pathlib import Path

import numpy as np

from densecavoid.frames import Command
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.mesh import Mesh
from densecavoid.sim.spec import WorldSpec
from densecavoid.sim.world import SimConfig, Simulator
from simulator import median_us


def grid_faces(rows: int, columns: int, first: int = 0) -> np.ndarray:
    """Two triangles for each cell of a grid of so many vertices."""
    number = np.arange(rows * columns).reshape(rows, columns) + first
    cells = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], -1).reshape(-1, 4)
    return np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]])


def rough_room(cells: int = 66, size: float = 8.0) -> Mesh:
    """A scanned room: floor and four walls with bumps of centimetres, 20,000 triangles and more."""
    rng = np.random.default_rng(0)
    vertices, faces, half, n = [], [], size / 2, cells + 1
    along, across = np.meshgrid(np.linspace(-half, half, n), np.linspace(-half, half, n), indexing="ij")
    vertices.append(np.stack([along, across, rng.uniform(-0.03, -0.01, along.shape)], -1).reshape(-1, 3))
    faces.append(grid_faces(n, n))
    rows = cells // 3 + 1
    along, height = np.meshgrid(np.linspace(-half, half, n), np.linspace(-0.05, 2.5, rows), indexing="ij")
    for turn in range(4):
        cos, sin = round(math.cos(turn * math.pi / 2)), round(math.sin(turn * math.pi / 2))
        inwards = half + rng.uniform(-0.04, 0.04, along.shape)
        faces.append(grid_faces(n, rows, sum(map(len, vertices))))
        wall = np.stack([cos * along - sin * inwards, sin * along + cos * inwards, height], -1)
        vertices.append(wall.reshape(-1, 3))
    return Mesh.from_triangles(np.concatenate(vertices), np.concatenate(faces), allow_open=True, name="room")


def stool(sectors: int = 63) -> Mesh:
    """A turned stool, a closed surface of 500 triangles: foot, leg and seat around one axis."""
    profile = np.array([(0.0, 0.0), (0.25, 0.0), (0.05, 0.05), (0.04, 0.42), (0.2, 0.45), (0.0, 0.47)])
    angles = np.arange(sectors) * 2 * np.pi / sectors
    ring = np.stack([np.cos(angles), np.sin(angles)], -1)
    body = [np.column_stack([radius * ring, np.full(sectors, z)]) for radius, z in profile[1:-1]]
    vertices = np.concatenate([[[0.0, 0.0, 0.0]], *body, [[0.0, 0.0, profile[-1, 1]]]])
    faces, last = [], len(vertices) - 1
    for s in range(sectors):
        t = (s + 1) % sectors
        faces += [(0, 1 + t, 1 + s), (last, last - sectors + s, last - sectors + t)]
        for r in range(len(body) - 1):
            a, b = 1 + r * sectors + s, 1 + r * sectors + t
            faces += [(a, b, b + sectors), (a, b + sectors, a + sectors)]
    return Mesh.from_triangles(vertices, np.array(faces), name="stool")


class MeshWorld:
    """One world with given meshes around the robot."""

    name = "meshes"

    def __init__(self, *meshes: Mesh) -> None:
        self.plan = FloorPlan()
        for i, mesh in enumerate(meshes):
            away = 0.0 if mesh.name == "room" else 2.0
            self.plan.mesh(mesh, away * math.cos(0.6 * i), away * math.sin(0.6 * i), 0.3 * i)

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return WorldSpec(self.name, self.plan, (0.1, 0.2, 0.3), (50.0, 0.0))


def mujoco_us(simulator: Simulator, seconds: float) -> float | None:
    """Time of MuJoCo's `mj_multiRay` for both sensors' rays in the same world; None where it is not installed."""
    try:
        from peers.ray_engines import MujocoRays, camera_rays, lidar_rays
    except ModuleNotFoundError as error:
        print(f"beside MuJoCo: skipped, {error.name} is not installed")
        return None
    lidar, camera, pose = simulator.config.lidar, simulator.config.camera, simulator.robot_pose[0]
    rays = (*lidar_rays(lidar, pose), lidar.max_range_m), (*camera_rays(camera, pose), camera.max_range_m)
    exact = MujocoRays(simulator.floor_plan(0), simulator.body_cylinders(0))
    return sum(median_us(exact.caster(*part), seconds / 2) for part in rays)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--seconds", type=float, default=1.0, help="for each figure, about")
    args = parser.parse_args()
    room, seat = rough_room(), stool()
    still = Command(np.zeros(1, np.float32), np.zeros(1, np.float32))
    record = []
    for name, meshes in (
        ("no mesh", ()),
        ("a stool", (seat,)),
        ("a room", (room,)),
        ("a room and ten stools", (room, *[seat] * 10)),
    ):
        simulator = Simulator(MeshWorld(*meshes), 1, SimConfig(threads=1))
        simulator.reset(np.zeros(1, np.int64))
        ours = median_us(simulator.sense, args.seconds)
        step = median_us(partial(simulator.step, still), args.seconds)
        triangles = sum(len(mesh.faces) for mesh in meshes)
        print(f"{ours:9.1f} us to sense, {step:6.1f} us to step a world with {name} ({triangles} triangles)")
        theirs = mujoco_us(simulator, args.seconds)
        if theirs is not None:
            print(f"{theirs:9.1f} us by mujoco: {theirs / ours:.0f} times ours")
        record.append(
            {"world": name, "triangles": triangles, "us_to_sense": ours, "us_to_step": step, "us_mujoco": theirs}
        )
    if args.json:
        args.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
