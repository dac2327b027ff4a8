"""Meshes for tests: a chair of closed parts, and a scanned room: rough, open, of many small triangles."""

from __future__ import annotations

import numpy as np

from densecavoid.sim.mesh import Mesh


def chair() -> Mesh:
    """Four legs, a seat and a back, each a closed box, in one mesh; it faces x."""
    parts = [(Mesh.box(0.44, 0.44, 0.04), (0.0, 0.0, 0.42)), (Mesh.box(0.04, 0.44, 0.44), (-0.2, 0.0, 0.46))]
    parts += [(Mesh.box(0.04, 0.04, 0.42), (x, y, 0.0)) for x in (-0.2, 0.2) for y in (-0.2, 0.2)]
    vertices = np.concatenate([part.vertices + np.array(place, np.float32) for part, place in parts])
    first = np.cumsum([0] + [len(part.vertices) for part, _ in parts[:-1]])
    faces = np.concatenate([part.faces + k for (part, _), k in zip(parts, first, strict=True)])
    return Mesh.from_triangles(vertices, faces, name="chair")


def ball(radius: float, centre_z: float, rings: int = 12) -> Mesh:
    """A closed ball of triangles around (0, 0, centre_z)."""
    sectors = 2 * rings
    polar, azimuth = np.meshgrid(np.arange(1, rings) * np.pi / rings, np.arange(sectors) * np.pi / rings, indexing="ij")
    body = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1)
    vertices = np.concatenate([[[0, 0, 1]], body.reshape(-1, 3), [[0, 0, -1]]]) * radius + [0, 0, centre_z]
    faces, last = [], len(vertices) - 1
    for s in range(sectors):
        t = (s + 1) % sectors
        faces += [(0, 1 + s, 1 + t), (last, last - sectors + t, last - sectors + s)]
        for r in range(rings - 2):
            a, b = 1 + r * sectors + s, 1 + r * sectors + t
            faces += [(a, a + sectors, b + sectors), (a, b + sectors, b)]
    return Mesh.from_triangles(vertices, np.array(faces), name="ball")


def scanned_room(cells: int = 76, size: float = 8.0, seed: int = 0) -> Mesh:
    """Floor and four walls with bumps of centimetres, about 4.6 `cells`^2 triangles, open above."""
    rng = np.random.default_rng(seed)
    vertices, faces, count, half = [], [], 0, size / 2
    floor = (-half, -half, -0.02), (size, 0, 0), (0, size, 0), (0, 0, 0.01), cells, cells
    corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
    walls = []
    for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1], strict=True):
        inwards = 0.04 * np.array([y0 - y1, x1 - x0, 0]) / size
        walls.append(((x0, y0, -0.05), (x1 - x0, y1 - y0, 0), (0, 0, 2.55), inwards, cells, max(2, cells // 3)))
    for origin, along, across, bump, n, m in (floor, *walls):
        a, b = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, m + 1), indexing="ij")
        flat = np.array(origin) + a[..., None] * np.array(along) + b[..., None] * np.array(across)
        vertices.append((flat + rng.uniform(-1, 1, a.shape)[..., None] * np.array(bump)).reshape(-1, 3))
        grid = np.arange(a.size).reshape(a.shape) + count
        square = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], -1).reshape(-1, 4)
        faces += [square[:, [0, 1, 2]], square[:, [0, 2, 3]]]
        count += a.size
    return Mesh.from_triangles(np.concatenate(vertices), np.concatenate(faces), allow_open=True, name="room")
