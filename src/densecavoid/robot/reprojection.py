"""Depth images of a camera that sits anywhere on the robot, drawn as the policy's camera would see the same surfaces.

Straight from the full image: after a resampling to the policy's view what lies outside of it would be lost, and what is
inside would be rounded twice. Each sample is a small piece of its surface (a surfel: Pfister et al., SIGGRAPH 2000)
that takes its slope from its neighbours, so that the map to the policy's image is exact for planes: a floor neither
tears nor moves. A pixel takes the nearest piece that covers its centre. Pieces are as large as the samples' share of
the image and no larger, which keeps silhouettes where they are; what a thing hides from the camera and not from the
policy's stays unknown (NaN).
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float32

from densecavoid.frames import CameraConfig
from densecavoid.robot.camera_mount import CameraMount
from densecavoid.robot.messages import DepthImage, Intrinsics, intrinsics_of
from densecavoid.sim._jit import inner, kernel

_MOST_SAMPLES = 4
"""Along a side of the policy's pixels: of finer images every second pixel is taken, or every third, and so on. More do
not show more, and take longer."""
_HALF = 0.55
"""Of a piece's side, in samples; beyond .5 they overlap, so that roundings and noise leave no cracks."""
_STEEPEST = 0.4
"""Greatest change of inverse depth from a sample to the next, as a share, that is still one surface (a floor's at 5 m
in an image of 80 x 60 is .19 from a height of .4 m, .38 from .2 m); more is an edge."""
_NEAREST_M = 0.1
"""Pieces nearer to the policy's camera are not drawn: they would fill the image."""


@inner
def _inverse_depth(depth, v, u):
    """1 / depth (1/m) of a pixel; where it has none, of the nearest of those around it; 0 where they have none."""
    nearest = depth[v, u]
    if not nearest > 0.0:
        nearest = np.float32(np.inf)
        for i in range(max(v - 1, 0), min(v + 2, depth.shape[0])):
            for j in range(max(u - 1, 0), min(u + 2, depth.shape[1])):
                if depth[i, j] < nearest:
                    nearest = depth[i, j]
    return 1.0 / nearest


@inner
def _slope(before, here, after):
    """Change of inverse depth a sample: towards the neighbour that differs less, since the other may be of another
    surface; none where a thing is one sample wide, or at an edge. Neighbours that are unknown are 0."""
    back, ahead = here - before, after - here
    if before <= 0.0:
        back = ahead
    if after <= 0.0:
        ahead = back
    slope = back if abs(back) < abs(ahead) else ahead
    return slope if back * ahead > 0.0 and abs(slope) <= _STEEPEST * here else 0.0


@kernel
def _sample(depth, step):
    """f64 [rows, columns] inverse depths of every `step`-th pixel; 0 where there is none."""
    begin = step // 2
    rows, columns = (depth.shape[0] - begin + step - 1) // step, (depth.shape[1] - begin + step - 1) // step
    inverse = np.empty((rows, columns))
    for i in range(rows):
        for j in range(columns):
            inverse[i, j] = _inverse_depth(depth, begin + step * i, begin + step * j)
    return inverse


@kernel
def _draw(inverse, step, pinhole, turn, shift, target, out):
    """Draws the pieces into `out` f32 [height, width], which is at inf where nothing is.

    With w the inverse depth and (1, a, b) the ray of a sample, q = turn (1, a, b) + w shift is its point in the
    policy's camera, divided by its depth in the other. On a plane w, and so q, is linear in the sample's place.

    Args:
        inverse: f64 [rows, columns] 1 / m of every `step`-th pixel.
        pinhole: focal lengths and centre (px) of the camera.
        turn, shift: f64 [3, 3] and [3]: pose of the camera in the policy's; axes ahead, left, up.
        target: focal lengths and centre (px) of the policy's camera.
    """
    focal_x, focal_y, centre_x, centre_y = pinhole
    target_x, target_y, middle_x, middle_y = target
    rows, columns = inverse.shape
    height, width = out.shape
    begin = step // 2
    for i in range(rows):
        b = (centre_y - (begin + step * i)) / focal_y
        for j in range(columns):
            w = inverse[i, j]
            if w <= 0.0:
                continue
            a = (centre_x - (begin + step * j)) / focal_x
            wu = _slope(inverse[i, j - 1] if j > 0 else 0.0, w, inverse[i, j + 1] if j + 1 < columns else 0.0)
            wv = _slope(inverse[i - 1, j] if i > 0 else 0.0, w, inverse[i + 1, j] if i + 1 < rows else 0.0)
            q0 = turn[0, 0] + turn[0, 1] * a + turn[0, 2] * b + shift[0] * w
            q1 = turn[1, 0] + turn[1, 1] * a + turn[1, 2] * b + shift[1] * w
            q2 = turn[2, 0] + turn[2, 1] * a + turn[2, 2] * b + shift[2] * w
            # Their change a sample to the right (u) and down (v).
            du, dv = -step / focal_x, -step / focal_y
            u0, u1, u2 = (
                turn[0, 1] * du + shift[0] * wu,
                turn[1, 1] * du + shift[1] * wu,
                turn[2, 1] * du + shift[2] * wu,
            )
            v0, v1, v2 = (
                turn[0, 2] * dv + shift[0] * wv,
                turn[1, 2] * dv + shift[1] * wv,
                turn[2, 2] * dv + shift[2] * wv,
            )
            if q0 - _HALF * (abs(u0) + abs(v0)) <= _NEAREST_M * w:
                continue
            left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
            for corner in range(4):
                m, n = _HALF if corner & 1 else -_HALF, _HALF if corner & 2 else -_HALF
                ahead = q0 + m * u0 + n * v0
                column = middle_x - target_x * (q1 + m * u1 + n * v1) / ahead
                row = middle_y - target_y * (q2 + m * u2 + n * v2) / ahead
                left, right, top, bottom = min(left, column), max(right, column), min(top, row), max(bottom, row)
            # Said so that NaN, which odd intrinsics make, is outside too.
            if not (right >= 0.0 and left <= width - 1 and bottom >= 0.0 and top <= height - 1):
                continue
            for row in range(math.ceil(max(top, 0.0)), math.floor(min(bottom, height - 1.0)) + 1):
                up = (middle_y - row) / target_y
                for column in range(math.ceil(max(left, 0.0)), math.floor(min(right, width - 1.0)) + 1):
                    aside = (middle_x - column) / target_x
                    # Where on the piece, (m, n) in samples, the pixel's ray (1, aside, up) meets it.
                    m1, n1, c1 = u1 - aside * u0, v1 - aside * v0, aside * q0 - q1
                    m2, n2, c2 = u2 - up * u0, v2 - up * v0, up * q0 - q2
                    area = m1 * n2 - n1 * m2
                    m, n = (c1 * n2 - n1 * c2) / area, (m1 * c2 - c1 * m2) / area
                    if abs(m) <= _HALF and abs(n) <= _HALF:
                        z = np.float32((q0 + m * u0 + n * v0) / (w + m * wu + n * wv))
                        out[row, column] = min(out[row, column], z)


@kernel
def _close_cracks(drawn, out):
    """Copies an image, with NaN for inf. A pixel without depth between two with depth takes the farther: behind a
    thing's edge goes on what is behind the thing, and the thing itself must not grow."""
    height, width = drawn.shape
    for v in range(height):
        for u in range(width):
            z = drawn[v, u]
            if z == np.inf and 0 < u < width - 1:
                z = max(drawn[v, u - 1], drawn[v, u + 1])
            if z == np.inf and 0 < v < height - 1:
                z = max(drawn[v - 1, u], drawn[v + 1, u])
            out[v, u] = z if z < np.inf else np.float32(np.nan)


def reproject(
    image: DepthImage, intrinsics: Intrinsics | None, mount: CameraMount, camera: CameraConfig
) -> Float32[np.ndarray, "rows columns"]:
    """What the policy's camera would see of the surfaces in an image.

    Args:
        image: as sent.
        intrinsics: of its camera; without, the image is taken to have the policy's field of view.
        mount: where its camera sits.
        camera: the policy's.

    Returns:
        Depth (m) along the policy's optical axis, not limited to its range; NaN where nobody has looked.

    Raises:
        ValueError: if the camera_info's shape is not the image's.
    """
    seen = intrinsics_of(image, intrinsics, camera)
    place = CameraMount.of(camera)
    turn = place.rotation.T @ mount.rotation
    shift = place.rotation.T @ (mount.pos_m - place.pos_m)
    target_x, target_y = camera.focal_px
    finer = min(seen.focal_x / target_x, seen.focal_y / target_y)
    step = min(max(1, math.ceil(finer / _MOST_SAMPLES - 0.01)), *image.shape)
    drawn = np.full((camera.height, camera.width), np.inf, np.float32)
    _draw(
        _sample(np.ascontiguousarray(image.depth_m), step),
        step,
        (seen.focal_x, seen.focal_y, seen.centre_x, seen.centre_y),
        turn,
        shift,
        (target_x, target_y, camera.width / 2 - 0.5, camera.height / 2 - 0.5),
        drawn,
    )
    out = np.empty_like(drawn)
    _close_cracks(drawn, out)
    return out
