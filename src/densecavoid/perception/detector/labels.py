"""Labels of people in a camera's image, from ground truth: the box of the whole body and how much of it is seen.

A person's box is that of the upright cylinder around their body (radius and height of `People`), hidden parts included,
cut at the image's edges; for a level camera it is `projection.body_box`, so that detector, truth detector and
prediction frame mean the same by a box. The whole body rather than its visible part, because its middle is where the
person stands and its foot how far away, whoever stands before them.

The visible share is that of the pixels which the body would fill, were it alone and the image wide enough, that show
the body and have a depth. What is above or below the image does not count as hidden: near people always reach beyond.
"""

from __future__ import annotations

import math

from densecavoid.frames import CameraConfig
from densecavoid.perception.projection import MIN_DEPTH_M
from densecavoid.sim._jit import kernel


@kernel
def project(forward, left, up, cos_pitch, sin_pitch, focal_x, focal_y, width, rows):
    """Pixel coordinates (u, v) of a point given from the camera, in the robot's upright frame (m)."""
    depth = max(forward * cos_pitch - up * sin_pitch, 1e-3)
    rise = forward * sin_pitch + up * cos_pitch
    return 0.5 * width - focal_x * left / depth, 0.5 * rows - focal_y * rise / depth


@kernel
def person_box(forward, left, radius, height, pitch, camera_height, focal_x, focal_y, width, rows):
    """Box (u_min, v_min, u_max, v_max) of a body's cylinder, `forward` and `left` of the camera (m); not yet cut.

    As `projection.body_box`, for a camera of any pitch: sides are the tangents to the body's disc, top and bottom
    those of its axis. An empty box (u_max < u_min) for nothing.
    """
    distance = math.sqrt(forward * forward + left * left)
    if forward < MIN_DEPTH_M or distance <= radius:
        return 0.0, 0.0, -1.0, -1.0
    cos, sin = math.cos(pitch), math.sin(pitch)
    bearing, half_width = math.atan2(left, forward), math.asin(radius / distance)
    limit = 0.5 * math.pi - 1e-3
    tangent = math.sqrt(distance * distance - radius * radius)
    u_min, u_max = math.inf, -math.inf
    for side in range(2):
        angle = bearing + (1.0 - 2.0 * side) * half_width
        angle = min(max(angle, -limit), limit)
        for top in range(2):
            up = top * height - camera_height
            u, _ = project(
                tangent * math.cos(angle), tangent * math.sin(angle), up, cos, sin, focal_x, focal_y, width, rows
            )
            u_min, u_max = min(u_min, u), max(u_max, u)
    _, v_min = project(forward, left, height - camera_height, cos, sin, focal_x, focal_y, width, rows)
    _, v_max = project(forward, left, -camera_height, cos, sin, focal_x, focal_y, width, rows)
    return u_min, v_min, u_max, v_max


@kernel
def _whole_pixels(parts, cos_yaw, sin_yaw, x, y, first, last, rows, width, pitch, camera_height, focal_x, focal_y):
    """Pixels from column `first` to `last`, beyond the image too, whose rays meet one of the body's cylinders."""
    cos, sin = math.cos(pitch), math.sin(pitch)
    count = 0
    for c in range(first, last):
        slope_left = (0.5 * width - (c + 0.5)) / focal_x
        for r in range(rows):
            slope_up = (0.5 * rows - (r + 0.5)) / focal_y
            ahead, rise = cos + slope_up * sin, slope_up * cos - sin
            length = ahead * ahead + slope_left * slope_left
            met = False
            for p in range(parts.shape[0]):
                radius = parts[p, 2]
                off_x, off_y = parts[p, 0] - x, parts[p, 1] - y
                forward, left = cos_yaw * off_x + sin_yaw * off_y, cos_yaw * off_y - sin_yaw * off_x
                middle = (ahead * forward + slope_left * left) / length
                miss = forward * slope_left - left * ahead
                inside = radius * radius - miss * miss / length
                if radius <= 0.0 or inside <= 0.0 or middle <= 0.0:
                    continue
                half = math.sqrt(inside / length)
                z0, z1 = camera_height + (middle - half) * rise, camera_height + (middle + half) * rise
                met = met or (min(z0, z1) <= parts[p, 4] and max(z0, z1) >= parts[p, 3])
            count += met
    return count


@kernel
def label_people(
    parts,
    pos,
    radius,
    height,
    active,
    ids,
    pose,
    depth,
    instance,
    mount_x,
    camera_height,
    pitch,
    focal_x,
    focal_y,
    boxes,
    share,
    place,
    body,
):
    """Writes the labels of one image; people of whom nothing could be in it are left out.

    Args:
        parts: [P, parts, 5] everybody's cylinders in the world.
        pos, radius, height, active, ids: [P, ...] everybody, in the same order.
        pose: x, y, yaw of the robot in the world.
        depth, instance: [rows, width] what the camera gives (NaN: no depth) and who is there (-1: nobody).
        boxes: [L, 4] gets u_min, v_min, u_max, v_max in pixels, cut at the image's edges.
        share: [L] gets the visible share.
        place: [L, 2] gets metres ahead and to the left of the robot's centre.
        body: [L, 2] gets radius and height in m.

    Returns:
        How many were written, at most L.
    """
    rows, width = depth.shape
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    x, y = pose[0] + cos * mount_x, pose[1] + sin * mount_x
    count = 0
    for i in range(pos.shape[0]):
        if not active[i] or count == boxes.shape[0]:
            continue
        off_x, off_y = pos[i, 0] - x, pos[i, 1] - y
        forward, left = cos * off_x + sin * off_y, cos * off_y - sin * off_x
        u_min, v_min, u_max, v_max = person_box(
            forward, left, radius[i], height[i], pitch, camera_height, focal_x, focal_y, width, rows
        )
        if u_max <= max(u_min, 0.0) or u_min >= width or v_max <= max(v_min, 0.0) or v_min >= rows:
            continue
        seen = 0
        for r in range(rows):
            for c in range(width):
                seen += instance[r, c] == ids[i] and not math.isnan(depth[r, c])
        if seen == 0:
            continue
        # Legs step beyond the cylinder, so columns to either side are looked at too.
        margin = math.ceil(0.5 * (u_max - u_min)) + 1
        first, last = max(-width, math.floor(u_min) - margin), min(2 * width, math.ceil(u_max) + margin)
        whole = _whole_pixels(
            parts[i], cos, sin, x, y, first, last, rows, width, pitch, camera_height, focal_x, focal_y
        )
        boxes[count, 0], boxes[count, 1] = max(u_min, 0.0), max(v_min, 0.0)
        boxes[count, 2], boxes[count, 3] = min(u_max, width), min(v_max, rows)
        share[count] = min(1.0, seen / max(whole, 1))
        place[count, 0], place[count, 1] = forward + mount_x, left
        body[count, 0], body[count, 1] = radius[i], height[i]
        count += 1
    return count


def camera_numbers(camera: CameraConfig) -> tuple[float, float, float, float, float]:
    """mount_x, height, pitch and the two focal lengths, as `label_people` takes them."""
    focal_x, focal_y = camera.focal_px
    mount = float(camera.mount_x_m), float(camera.mount_height_m), float(camera.mount_pitch_rad)
    return *mount, float(focal_x), float(focal_y)
