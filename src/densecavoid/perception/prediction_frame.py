"""The prediction frame: black boxes on white where tracked people are expected in the camera image (paper, Fig. 2b).

People move on at constant velocity, and so does the robot: the image is the one the camera will have then.
"""

from __future__ import annotations

import math

import numpy as np

from densecavoid.perception.projection import body_box, pixel_span
from densecavoid.sim._jit import kernel
from densecavoid.sim.robot import drive

FREE, TAKEN = np.uint8(255), np.uint8(0)


@kernel
def draw_prediction(image, tracks, b, pose, linear, angular, horizon_s, focal_x, focal_y, camera_height):
    """Fills `image` [height, width] for world b.

    Args:
        pose: x, y, yaw of the robot in the odometry frame, now.
        linear, angular: the robot's velocity now (m/s, rad/s).
        horizon_s: how far ahead.
    """
    rows, width = image.shape
    for v in range(rows):
        for u in range(width):
            image[v, u] = FREE
    then = np.empty(3)
    for axis in range(3):
        then[axis] = pose[axis]
    drive(then, linear, angular, horizon_s)
    cos, sin = math.cos(then[2]), math.sin(then[2])
    for t in range(tracks.confirmed.shape[1]):
        if not tracks.confirmed[b, t]:
            continue
        state = tracks.state[b, t]
        off_x = state[0] + state[2] * horizon_s - then[0]
        off_y = state[1] + state[3] * horizon_s - then[1]
        forward, left = cos * off_x + sin * off_y, cos * off_y - sin * off_x
        u_min, v_min, u_max, v_max = body_box(
            forward,
            left,
            tracks.body[b, t, 0],
            tracks.body[b, t, 1],
            focal_x,
            focal_y,
            width,
            rows,
            camera_height,
        )
        first, last = pixel_span(u_min, u_max, width)
        top, bottom = pixel_span(v_min, v_max, rows)
        for v in range(top, bottom):
            for u in range(first, last):
                image[v, u] = TAKEN
