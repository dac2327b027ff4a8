"""Episodes made by hand."""

from __future__ import annotations

import numpy as np

from densecavoid.benchmark.episode import Episode

DT_S = 0.1


def episode(position_w, outcome: str = "timeout", goal_w=(5.0, 0.0), **changes) -> Episode:
    """An episode along the given places, one each .1 s, with nothing near."""
    position_w = np.asarray(position_w, np.float64)
    instants = len(position_w)
    values = {
        "scenario": "by-hand",
        "navigator": "nobody",
        "seed": 7,
        "outcome": outcome,
        "collided_person": False,
        "robot_approached": False,
        "time_s": DT_S * np.arange(instants),
        "pose_w": np.column_stack([position_w, np.zeros(instants)]),
        "velocity": np.zeros((instants, 2)),
        "command": np.zeros((instants - 1, 2)),
        "clearance_m": np.full(instants - 1, 2.0),
        "clearance_people_m": np.full(instants - 1, np.inf),
        "goal_w": np.asarray(goal_w, np.float64),
    }
    return Episode(**values | changes)


def straight(length_m: float, duration_s: float) -> np.ndarray:
    """Places on the x axis at constant speed from 0."""
    x = np.linspace(0.0, length_m, round(duration_s / DT_S) + 1)
    return np.column_stack([x, np.zeros_like(x)])
