"""The paper's three sensor configurations and the lidar alone, made from the full observation by blanking what is not
there. One function serves training and the runtime, so that a policy meets on the robot what it was trained with.
"""

from __future__ import annotations

import numpy as np

from densecavoid.frames import Observation, choose

SENSORS = ("densecavoid", "depth-lidar", "depth", "lidar")
"""Everything; without the prediction frame; the depth camera alone (paper, Tables I and II); the lidar alone."""


def mask_observation(observation: Observation, sensors: str) -> Observation:
    """The observation as the sensor configuration sees it: a blank prediction frame is white (nobody there), a blank
    lidar all ones (nothing in range), a blank depth image 0 (no depth). The arrays given are not written to.

    Raises:
        ValueError: if `sensors` is not one of `SENSORS`.
    """
    choose("sensor configuration", sensors, SENSORS)
    if sensors == "densecavoid":
        return observation
    observation = observation._replace(prediction=np.full_like(observation.prediction, 255))
    if sensors == "depth":
        observation = observation._replace(lidar=np.ones_like(observation.lidar))
    elif sensors == "lidar":
        observation = observation._replace(camera=np.zeros_like(observation.camera))
    return observation
