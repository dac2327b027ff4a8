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

from densecavoid.perception.projection import MIN_DEPTH_M, ahead_per_depth, from_camera, rise_per_depth
from densecavoid.sim._jit import kernel


@kernel
def project(forward, left, up, view):
    """Pixel coordinates (u, v) of a point given from the camera, in the robot's upright frame (m)."""
    depth = max(forward * view.cos_pitch - up * view.sin_pitch, 1e-3)
    rise = forward * view.sin_pitch + up * view.cos_pitch
    return 0.5 * view.width - view.focal_x * left / depth, 0.5 * view.rows - view.focal_y * rise / depth


@kernel
def person_box(forward, left, radius, height, view):
    """Box (u_min, v_min, u_max, v_max) of a body's cylinder, `forward` and `left` of the camera (m); not yet cut.

    As `projection.body_box`, which for a pitched camera takes a rectangle for the body, where this is the body's own
    outline: sides are the tangents to its disc, top and bottom those of its axis. An empty box (u_max < u_min) for
    nothing.
    """
    distance = math.sqrt(forward * forward + left * left)
    if forward < MIN_DEPTH_M or distance <= radius:
        return 0.0, 0.0, -1.0, -1.0
    bearing, half_width = math.atan2(left, forward), math.asin(radius / distance)
    limit = 0.5 * math.pi - 1e-3
    tangent = math.sqrt(distance * distance - radius * radius)
    u_min, u_max = math.inf, -math.inf
    for side in range(2):
        angle = bearing + (1.0 - 2.0 * side) * half_width
        angle = min(max(angle, -limit), limit)
        for top in range(2):
            u, _ = project(tangent * math.cos(angle), tangent * math.sin(angle), top * height - view.height_m, view)
            u_min, u_max = min(u_min, u), max(u_max, u)
    _, v_min = project(forward, left, height - view.height_m, view)
    _, v_max = project(forward, left, -view.height_m, view)
    return u_min, v_min, u_max, v_max


@kernel
def _whole_pixels(parts, pose, first, last, view):
    """Pixels from column `first` to `last`, beyond the image too, whose rays meet one of the body's cylinders."""
    count = 0
    for c in range(first, last):
        slope_left = (0.5 * view.width - (c + 0.5)) / view.focal_x
        for r in range(view.rows):
            ahead, rise = ahead_per_depth(view, r + 0.5), rise_per_depth(view, r + 0.5)
            length = ahead * ahead + slope_left * slope_left
            met = False
            for p in range(parts.shape[0]):
                radius = parts[p, 2]
                forward, left = from_camera(view, pose, parts[p, 0], parts[p, 1])
                middle = (ahead * forward + slope_left * left) / length
                miss = forward * slope_left - left * ahead
                inside = radius * radius - miss * miss / length
                if radius <= 0.0 or inside <= 0.0 or middle <= 0.0:
                    continue
                half = math.sqrt(inside / length)
                z0, z1 = view.height_m + (middle - half) * rise, view.height_m + (middle + half) * rise
                met = met or (min(z0, z1) <= parts[p, 4] and max(z0, z1) >= parts[p, 3])
            count += met
    return count


@kernel
def label_people(parts, people, b, pose, depth, instance, view, boxes, share, place, body):
    """Writes the labels of one image; people of whom nothing could be in it are left out.

    Args:
        parts: [P, parts, 5] everybody's cylinders in the world.
        people: a `frames.People`, in the same order; those of world b count.
        pose: x, y, yaw of the robot in the world.
        depth, instance: [rows, width] what the camera gives (NaN: no depth) and who is there (-1: nobody).
        view: a `CameraView`.
        boxes: [L, 4] gets u_min, v_min, u_max, v_max in pixels, cut at the image's edges.
        share: [L] gets the visible share.
        place: [L, 2] gets metres ahead and to the left of the robot's centre.
        body: [L, 2] gets radius and height in m.

    Returns:
        How many were written, at most L.
    """
    rows, width = depth.shape
    count = 0
    for i in range(people.pos_w.shape[1]):
        if not people.active[b, i] or count == boxes.shape[0]:
            continue
        forward, left = from_camera(view, pose, people.pos_w[b, i, 0], people.pos_w[b, i, 1])
        radius, height = people.radius_m[b, i], people.height_m[b, i]
        u_min, v_min, u_max, v_max = person_box(forward, left, radius, height, view)
        if u_max <= max(u_min, 0.0) or u_min >= width or v_max <= max(v_min, 0.0) or v_min >= rows:
            continue
        seen = 0
        for r in range(rows):
            for c in range(width):
                seen += instance[r, c] == people.id[b, i] and not math.isnan(depth[r, c])
        if seen == 0:
            continue
        # Legs step beyond the cylinder, so columns to either side are looked at too.
        margin = math.ceil(0.5 * (u_max - u_min)) + 1
        first, last = max(-width, math.floor(u_min) - margin), min(2 * width, math.ceil(u_max) + margin)
        whole = _whole_pixels(parts[i], pose, first, last, view)
        boxes[count, 0], boxes[count, 1] = max(u_min, 0.0), max(v_min, 0.0)
        boxes[count, 2], boxes[count, 3] = min(u_max, width), min(v_max, rows)
        share[count] = min(1.0, seen / max(whole, 1))
        place[count, 0], place[count, 1] = forward + view.ahead_m, left
        body[count, 0], body[count, 1] = radius, height
        count += 1
    return count
