"""People in the robot's frame, as those need them who plan among them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from densecavoid.frames import SensorFrame, into_robot_frame, seen_from
from densecavoid.perception.tracker_settings import TrackerSettings
from densecavoid.perception.tracks import Tracks


class People(NamedTuple):
    """People in the robot's frame (x ahead, y left); slots that are not `there` hold no meaning."""

    pos_r: Float[np.ndarray, "B P 2"]
    vel_r: Float[np.ndarray, "B P 2"]
    """Over ground, seen along the robot's axes, m/s."""
    radius_m: Float[np.ndarray, "B P"]
    there: Bool[np.ndarray, "B P"]


def nobody(num_worlds: int) -> People:
    """No people in so many worlds."""
    places = np.zeros((num_worlds, 0, 2))
    return People(places, places, np.zeros((num_worlds, 0)), np.zeros((num_worlds, 0), np.bool_))


def people_of(tracks: Tracks, frame: SensorFrame, standing: bool = False) -> People:
    """Those whom a tracker is sure of.

    Args:
        tracks: of the frame's worlds.
        frame: what the robot's sensors gave.
        standing: whether what has legs but has not been seen to walk is taken for somebody who stands. It may be a
            table; its top, too, reaches beyond the legs that the lidar meets, as a body does.
    """
    radius_m, there = tracks.body[..., 0], tracks.confirmed
    vel_w = tracks.state[..., 2:]
    if standing:
        may_be = tracks.live & ~there & (tracks.existence > TrackerSettings().confirmed)
        vel_w, there = np.where(may_be[..., None], 0.0, vel_w), there | may_be
    return people_around(frame.odom_pose, tracks.state[..., :2], vel_w, radius_m, there)


def people_around(
    pose: Float[np.ndarray, "B 3"],
    pos: Float[np.ndarray, "B P 2"],
    vel: Float[np.ndarray, "B P 2"],
    radius_m: Float[np.ndarray, "B P"],
    there: Bool[np.ndarray, "B P"],
) -> People:
    """People whose places and velocities are known in the frame of the robot's pose."""
    return People(
        seen_from(pose, np.asarray(pos, np.float64)),
        into_robot_frame(pose[:, 2], np.asarray(vel, np.float64)),
        np.asarray(radius_m, np.float64),
        np.asarray(there, np.bool_),
    )
