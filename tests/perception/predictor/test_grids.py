"""RobustTP's grids: who sits in which cell of a hand-made scene, and in whose frame."""

from __future__ import annotations

import numpy as np

from densecavoid.perception.predictor.contract import histories_of
from densecavoid.perception.predictor.grids import NUM_CELLS, SLOTS, compute_grids, horizon_cell, neighbour_cell
from densecavoid.perception.predictor.kalman import KalmanPredictor

BASE = KalmanPredictor()


def scene(places: list[tuple[float, float]], velocities: list[tuple[float, float]], turn_rad: float = 0.0):
    """People who have walked straight for 8 steps, the whole turned and moved."""
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    turn = np.array([[cos, -sin], [sin, cos]])
    here, way = np.array(places) @ turn.T + [30.0, -7.0], np.array(velocities) @ turn.T
    pos = here[:, None] + way[:, None] * 0.4 * np.arange(-7, 1)[:, None]
    return histories_of(pos, 0.4, velocity=way)


def cells_of(features, track: int) -> dict[int, tuple[list[int], list[int]]]:
    """Neighbour: its cells on both grids."""
    found = {}
    for slot in range(SLOTS):
        if features.pair[track, slot, 4]:
            cells = np.flatnonzero(features.cells[track, slot])
            near, ahead = cells[cells < NUM_CELLS[0]], cells[cells >= NUM_CELLS[0]] - NUM_CELLS[0]
            found[int(features.neighbour[track, slot])] = (near.tolist(), ahead.tolist())
    return found


def test_neighbours_sit_in_the_cells_where_they_stand() -> None:
    walking_up = (0.0, 1.0)
    places = [(0.0, 0.0), (0.0, 2.0), (-0.9, 0.1), (0.9, -3.0), (0.3, 7.5), (0.0, 30.0), (1.0, 2.1)]
    for turn in (0.0, 1.0, -2.5):
        features = compute_grids(scene(places, [walking_up] * 7, turn), BASE)
        # Cells of .8 m in 13 rows by 3 columns: 2.0 m ahead is row 9 (1.6-2.4... counted from -5.2 m), middle column.
        assert cells_of(features, 0) == {
            1: ([9 * 3 + 1], [1 * 3 + 1]),  # 1.2 to 2.4 m is the second row of the horizon
            2: ([6 * 3 + 2], [0 * 3 + 2]),  # beside, to the left: the last column
            3: ([2 * 3 + 0], []),  # behind, to the right
            4: ([], [6 * 3 + 1]),  # too far for the neighbour grid
            6: ([9 * 3 + 0], [1 * 3 + 0]),
        }


def test_the_nearest_holds_a_cell() -> None:
    places = [(0.0, 0.0), (2.3, 0.2), (2.1, 0.0), (2.2, -0.1)]
    features = compute_grids(scene(places, [(1.0, 0.0)] * 4), BASE)
    assert list(cells_of(features, 0)) == [2]
    np.testing.assert_allclose(features.pair[0, 0], [2.1, 0.0, 1.0, 0.0, 1.0], atol=1e-6)


def test_cells_by_hand() -> None:
    assert neighbour_cell(0.0, 0.0) == 6 * 3 + 1  # the track's own
    assert neighbour_cell(5.1, 1.1) == 12 * 3 + 2 and neighbour_cell(5.3, 0.0) == -1
    assert neighbour_cell(-5.1, -1.1) == 0 and neighbour_cell(0.0, 1.3) == -1
    assert horizon_cell(0.1, 0.0) == 1 and horizon_cell(-0.1, 0.0) == -1 and horizon_cell(8.3, -1.7) == 6 * 3


def test_histories_are_in_metres_in_their_own_direction_and_oncomers_face_the_track() -> None:
    features = compute_grids(scene([(0.0, 0.0), (3.0, 0.5)], [(1.0, 0.0), (-0.5, 0.0)], 0.7), BASE)
    np.testing.assert_allclose(features.own[0, :, 0], 0.4 * np.arange(-7, 1), atol=1e-5)
    np.testing.assert_allclose(features.own[1, :, 0], 0.2 * np.arange(-7, 1), atol=1e-5)
    np.testing.assert_allclose(features.own[:, 1:, 2], np.array([[1.0], [0.5]]).repeat(7, 1), atol=1e-5)
    np.testing.assert_allclose(features.own[..., [1, 3]], 0.0, atol=1e-5)
    np.testing.assert_allclose(features.pair[0, 0], [3.0, 0.5, -1.0, 0.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(features.pair[1, 0], [3.0, 0.5, -1.0, 0.0, 1.0], atol=1e-6)


def test_the_order_of_people_changes_nothing_and_other_groups_are_not_seen() -> None:
    rng = np.random.default_rng(0)
    places, ways = rng.uniform(-3, 3, (6, 2)), rng.normal(size=(6, 2))
    order = rng.permutation(6)
    first, second = (
        compute_grids(scene([tuple(p) for p in places[k]], [tuple(w) for w in ways[k]]), BASE)
        for k in (np.arange(6), order)
    )
    for n in range(6):
        theirs = cells_of(second, n)
        ours = {int(np.flatnonzero(order == m)[0]): cells for m, cells in cells_of(first, int(order[n])).items()}
        assert ours == theirs
    apart = scene([tuple(p) for p in places], [tuple(w) for w in ways])._replace(group=np.arange(6))
    assert not compute_grids(apart, BASE).cells.any()


def test_missing_places_are_masked() -> None:
    histories = scene([(0.0, 0.0), (1.0, 0.0)], [(1.0, 0.0)] * 2)
    valid = histories.valid.copy()
    valid[0, :5] = False
    features = compute_grids(histories._replace(valid=valid), BASE)
    assert not features.own[0, :5].any() and features.own[0, 5, 2] == 0.0 and features.own[0, 6, 2] > 0.9
