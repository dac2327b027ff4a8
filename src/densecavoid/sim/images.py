"""Colour, class and instance of every pixel: what training a detector needs and a depth camera does not give."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int32, UInt8

from densecavoid.frames import CameraConfig
from densecavoid.sim._jit import for_worlds, inner, kernel
from densecavoid.sim.depth import camera_optics
from densecavoid.sim.geometry import GROUND, NOTHING
from densecavoid.sim.kernels import picture
from densecavoid.sim.materials import GLASS, material_colours, material_number
from densecavoid.sim.people import PARTS, RIGHT_LEG
from densecavoid.sim.returns import glass_distance
from densecavoid.sim.state import WorldState
from densecavoid.sim.surfaces import CLOTHES, SKIN, material_at, normal_at, solids_of

CLASSES = ("nothing", "ground", "ceiling", "thing", "glass", "person")
"""What the numbers of a segmentation image mean."""

_NOTHING, _GROUND, _CEILING, _THING, _GLASS, _PERSON = range(len(CLASSES))
_SKY = np.array([(0.62, 0.74, 0.88)], np.float32)
_CLOTHES = np.array(
    [
        (0.13, 0.16, 0.25),
        (0.70, 0.70, 0.68),
        (0.55, 0.18, 0.16),
        (0.20, 0.34, 0.50),
        (0.30, 0.38, 0.24),
        (0.72, 0.58, 0.30),
        (0.12, 0.12, 0.13),
        (0.45, 0.30, 0.42),
    ],
    np.float32,
)
_SKINS = np.array([(0.88, 0.70, 0.58), (0.76, 0.57, 0.44), (0.55, 0.38, 0.27), (0.36, 0.24, 0.17)], np.float32)
_TILE_M = 0.5
_LIGHT = (0.34, 0.20, 0.92)
"""From where the light comes, a unit vector about."""
_AMBIENT = 0.55
_PANE = 0.25  # share of a pane's own colour in what is seen through it


class Images(NamedTuple):
    """What a camera shows, pixel for pixel; exact, whatever the sensors' noise. Row 0 is the top, column 0 the left."""

    rgb: UInt8[np.ndarray, "B height width 3"]
    depth_m: Float32[np.ndarray, "B height width"]
    """Along the optical axis, to whatever the light comes from; NaN out of the camera's range."""
    segmentation: UInt8[np.ndarray, "B height width"]
    """Numbers in `CLASSES`."""
    instance: Int32[np.ndarray, "B height width"]
    """A person's `People.id`; -1 where nobody is."""


@inner
def _write(pixel, colours, k, brightness):
    for channel in range(3):
        pixel[channel] = np.uint8(min(255.0, 255.0 * brightness * colours[k, channel]))


@inner
def _paint(pixel, solids, hit, x, y, colours, ground, ceiling, brightness):
    """Writes the colour of a surface in light of some brightness."""
    material = material_at(solids, hit, ground, ceiling)
    if material == SKIN:
        _write(pixel, _SKINS, solids.person_id[hit // PARTS] % len(_SKINS), brightness)
    elif material == CLOTHES:  # trousers and shirt: two colours that seldom repeat together
        piece = 5 * solids.person_id[hit // PARTS] + (3 if hit % PARTS <= RIGHT_LEG else 0)
        _write(pixel, _CLOTHES, piece % len(_CLOTHES), brightness)
    else:
        dark_tile = hit == GROUND and (math.floor(x / _TILE_M) + math.floor(y / _TILE_M)) % 2 == 0
        _write(pixel, colours, material, brightness * (0.9 if dark_tile else 1.0))


@kernel
def draw_images(first, last, state, which, rgb, depth, segmentation, instance, hits, camera, colours, ground, ceiling):
    """Fills the images of the marked worlds; `hits` i32 [B, height, width] is scratch space."""
    for b in range(first, last):
        if not which[b]:
            continue
        picture(state, b, depth[b], hits[b], camera)
        shade(
            solids_of(state, b),
            state.robot_pose[b],
            rgb[b],
            depth[b],
            segmentation[b],
            instance[b],
            hits[b],
            camera,
            colours,
            ground,
            ceiling,
        )


@inner
def shade(solids, pose, rgb, depth, segmentation, instance, hits, camera, colours, ground, ceiling):
    """Colours one image whose depths and hits are known, and limits its depths to the camera's range."""
    cos_pitch, sin_pitch = math.cos(camera.pitch), math.sin(camera.pitch)
    x, y, yaw = pose
    cos, sin = math.cos(yaw), math.sin(yaw)
    origin = (x + cos * camera.ahead, y + sin * camera.ahead, camera.height)
    for v in range(depth.shape[0]):
        up = camera.row_slope[v]
        ahead, rise = cos_pitch + up * sin_pitch, up * cos_pitch - sin_pitch
        for u in range(depth.shape[1]):
            left = camera.column_slope[u]
            ray = (cos * ahead - sin * left, sin * ahead + cos * left, rise)
            hit, t = hits[v, u], depth[v, u]
            instance[v, u] = -1
            pixel = rgb[v, u]
            if hit == NOTHING:
                segmentation[v, u] = _NOTHING
                _write(pixel, _SKY, 0, 1.0)
            else:
                at_x, at_y, at_z = origin[0] + t * ray[0], origin[1] + t * ray[1], origin[2] + t * ray[2]
                n_x, n_y, n_z = normal_at(solids, hit, at_x, at_y, at_z)
                light = max(0.0, n_x * _LIGHT[0] + n_y * _LIGHT[1] + n_z * _LIGHT[2])
                # What faces the eye is a little lighter, which tells apart the sides that face no light.
                facing = abs(n_x * ray[0] + n_y * ray[1] + n_z * ray[2]) / math.sqrt(1.0 + up * up + left * left)
                brightness = _AMBIENT + 0.4 * light + 0.2 * facing
                _paint(pixel, solids, hit, at_x, at_y, colours, ground, ceiling, brightness)
                if hit < 0:
                    segmentation[v, u] = _GROUND if hit == GROUND else _CEILING
                elif hit < PARTS * solids.person_id.shape[0]:
                    segmentation[v, u] = _PERSON
                    instance[v, u] = solids.person_id[hit // PARTS]
                else:
                    segmentation[v, u] = _THING
            for k in range(solids.first_glass, solids.num_boxes):
                pane = glass_distance(solids.boxes, k, origin, ray)
                if 0.0 < pane < t:
                    for channel in range(3):
                        own = 255.0 * colours[GLASS, channel]
                        pixel[channel] = np.uint8((1.0 - _PANE) * pixel[channel] + _PANE * own)
                    if segmentation[v, u] != _PERSON:
                        segmentation[v, u] = _GLASS
            if not camera.min_range <= t <= camera.max_range:
                depth[v, u] = np.nan


def take_images(state: WorldState, camera: CameraConfig, which: Bool[np.ndarray, "B"], threads: int) -> Images:
    """Images of the marked worlds through a camera on each robot; those of the others are black and show nothing."""
    shape = len(state.goal), camera.height, camera.width
    images = Images(
        np.zeros((*shape, 3), np.uint8),
        np.full(shape, np.nan, np.float32),
        np.zeros(shape, np.uint8),
        np.full(shape, -1, np.int32),
    )
    hits = np.empty(shape, np.int32)
    materials = material_colours(), material_number("concrete"), material_number("plaster")
    for_worlds(draw_images, shape[0], threads, state, which, *images, hits, camera_optics(camera), *materials)
    return images
