"""Lengths of ways around the robot, beside Dijkstra's search."""

from __future__ import annotations

import heapq
import itertools
import math

import numpy as np

from densecavoid.perception.ways import spread_distances


def dijkstra(slowness: np.ndarray, goal: tuple[int, int], cell: float) -> np.ndarray:
    """Shortest ways over the eight neighbours of each cell, a step at the mean cost of its ends."""
    distance = np.full(slowness.shape, np.inf)
    distance[goal] = 0.0
    queue = [(0.0, goal)]
    while queue:
        so_far, (i, j) = heapq.heappop(queue)
        if so_far > distance[i, j]:
            continue
        for di, dj in itertools.product((-1, 0, 1), repeat=2):
            at = i + di, j + dj
            if (di, dj) != (0, 0) and min(at) >= 0 and at[0] < slowness.shape[0] and at[1] < slowness.shape[1]:
                length = so_far + math.hypot(di, dj) * cell * 0.5 * (slowness[i, j] + slowness[at])
                if length < distance[at]:
                    distance[at] = length
                    heapq.heappush(queue, (length, at))
    return distance


def test_ways_are_as_long_as_a_search_finds_them() -> None:
    """Around walls with one opening; the search can only take eight directions, at worst 8 % too long."""
    slowness, cell, goal = np.ones((40, 40)), 0.1, (35, 5)
    slowness[20, :30] = slowness[10, 10:] = 1000.0
    searched = dijkstra(slowness, goal, cell)
    swept, known = np.full(slowness.shape, 1e6), np.zeros(slowness.shape, np.bool_)
    swept[goal], known[goal] = 0.0, True
    spread_distances(swept, slowness, known, cell)
    free = slowness == 1.0
    # A sweep of the first order is some cells too long beside the goal and behind corners.
    assert (swept[free] < searched[free] + 4 * cell).all()
    assert (swept[free] > 0.92 * searched[free] - cell).all()
    assert swept[0, 39] > 6.0  # and they lead around
