"""The truth about the people around each robot, for privileged critics and teachers in training. No policy that runs on
a robot sees it.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from densecavoid.frames import PERSON_NUMBERS, into_robot_frame
from densecavoid.sim.world import Simulator


def nearest_people(simulator: Simulator, count: int) -> Float32[np.ndarray, "B count numbers"]:
    """The `count` people nearest to each robot, nearest first, whether the sensors see them or not; 0 where there are
    fewer.
    """
    people, pose = simulator.people(), simulator.robot_pose
    told = np.zeros((simulator.num_worlds, count, PERSON_NUMBERS), np.float32)
    if people.pos_w.shape[1] == 0:
        return told
    offset = people.pos_w - pose[:, None, :2]
    distance = np.where(people.active, np.hypot(offset[..., 0], offset[..., 1]), np.inf)
    nearest = np.argsort(distance, axis=1, kind="stable")[:, :count]
    rows = np.arange(simulator.num_worlds)[:, None]
    there = people.active[rows, nearest]
    for first, vectors in ((0, offset), (2, people.vel_w)):
        turned = into_robot_frame(pose[:, 2], vectors[rows, nearest])
        told[:, : nearest.shape[1], first : first + 2] = np.where(there[..., None], turned, 0.0)
    told[:, : nearest.shape[1], 4] = np.where(there, people.radius_m[rows, nearest], 0.0)
    told[:, : nearest.shape[1], 5] = there
    return told
