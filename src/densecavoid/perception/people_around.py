"""People in the robot's frame, as those need them who plan among them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from densecavoid.frames import SensorFrame, into_robot_frame, seen_from
from densecavoid.perception.tracker_settings import TrackerSettings
from densecavoid.perception.tracks import Tracks

# Of the time for which people are watched, the share that the tracker takes for turns: .07 to .09 in `dense-ped`, whose
# people walk straight, .08 to .13 in `corridor-15`, .15 to .18 in `random-sparse-ped`, whose people change their mind.
_USUAL_SHARE = 0.1
_TURNS_PER_SHARE = 7.0
_USUAL_S = 4.0  # watched, it is believed half


class People(NamedTuple):
    """People in the robot's frame (x ahead, y left); slots that are not `there` hold no meaning."""

    pos_r: Float[np.ndarray, "B P 2"]
    vel_r: Float[np.ndarray, "B P 2"]
    """Over ground, seen along the robot's axes, m/s."""
    radius_m: Float[np.ndarray, "B P"]
    there: Bool[np.ndarray, "B P"]
    turns_per_s: Float[np.ndarray, "B"]
    """How often one of them takes another course, as far as can be told from how they have moved."""


def nobody(num_worlds: int) -> People:
    """No people in so many worlds."""
    places = np.zeros((num_worlds, 0, 2))
    return People(places, places, np.zeros((num_worlds, 0)), np.zeros((num_worlds, 0), np.bool_), np.zeros(num_worlds))


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
    people = people_around(frame.odom_pose, tracks.state[..., :2], vel_w, radius_m, there)
    return people._replace(turns_per_s=turns_per_s(tracks))


def turns_per_s(tracks: Tracks) -> Float[np.ndarray, "B"]:
    """How often people take another course: 0 where they walk straight on, as long as little has been seen of them."""
    share = (tracks.turning_s + _USUAL_SHARE * _USUAL_S) / (tracks.watched_s + _USUAL_S)
    return _TURNS_PER_SHARE * np.maximum(share - _USUAL_SHARE, 0.0)


def people_around(
    pose: Float[np.ndarray, "B 3"],
    pos: Float[np.ndarray, "B P 2"],
    vel: Float[np.ndarray, "B P 2"],
    radius_m: Float[np.ndarray, "B P"],
    there: Bool[np.ndarray, "B P"],
) -> People:
    """People whose places and velocities are known in the frame of the robot's pose; taken to walk straight on."""
    return People(
        seen_from(pose, np.asarray(pos, np.float64)),
        into_robot_frame(pose[:, 2], np.asarray(vel, np.float64)),
        np.asarray(radius_m, np.float64),
        np.asarray(there, np.bool_),
        np.zeros(len(pose)),
    )
