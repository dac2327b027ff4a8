"""Nets of places for people in buildings: straight free ways from place to place, found from the floor plan."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from densecavoid.scenarios.free_space import Area, Ground, Point, clearance_grid_m, way_is_clear
from densecavoid.sim.clearance import FOR_PEOPLE, clearances_m
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.spec import NET_LINKS, NET_PLACES, WalkNet

BODY_ROOM_M = 0.36
"""From the middle of a way to the nearest thing: a broad body, and some."""
_COMFORTABLE_M, _SHORT_CELLS = 0.65, 3  # they keep this from corners, unless it makes them stop every few cells
_ROOMY_M = 1.2  # ways prefer to keep this far from things
_SPREAD_M = 0.9
_DESTINATION_EVERY_M2 = 5.0
_MAX_DESTINATIONS = 24
_SAME_PLACE_M = 0.7
_NEIGHBOURS = 3


class _Cells:
    """The cells of an area where people may walk, as a graph whose ways keep to the middle."""

    def __init__(
        self, plan: FloorPlan, area: Area, cell_m: float, near: tuple[float, float], ground: Ground | None
    ) -> None:
        from scipy.ndimage import label  # here, because it takes a tenth of a second that few worlds need

        self.origin, self.cell_m = np.array(area[:2]), cell_m
        self.clearance = clearance_grid_m(plan, area, cell_m, _ROOMY_M, FOR_PEOPLE)
        # The middle of a narrow door may lie half a cell from the nearest centre; `_centred` finds it again.
        free = self.clearance >= max(0.05, BODY_ROOM_M - cell_m / 2)
        if ground is not None:
            free[free] = ground(self.places(np.argwhere(free)))
        regions, count = label(free)  # type: ignore[misc]
        if count == 0:
            raise ValueError(f"no free space for people in {area}")
        # The part that the robot starts in: the one whose nearest cell is nearest.
        cells = np.argwhere(free)
        nearest = cells[np.argmin(np.hypot(*(self.places(cells) - near).T))]
        self.cells: Int[np.ndarray, "N 2"] = np.argwhere(regions == regions[tuple(nearest)])
        self.points: Float[np.ndarray, "N 2"] = self.places(self.cells)
        self.room: Float[np.ndarray, "N"] = self.clearance[tuple(self.cells.T)]
        self.graph = self._graph(free.shape)

    def places(self, cells: Int[np.ndarray, "N 2"]) -> Float[np.ndarray, "N 2"]:
        return self.origin + (cells + 0.5) * self.cell_m

    def _graph(self, shape: tuple[int, ...]) -> csr_matrix:
        index = np.full((shape[0] + 2, shape[1] + 2), -1)
        index[tuple(self.cells.T + 1)] = np.arange(len(self.cells))
        narrow = 1.0 + 2.0 * (1.0 - self.room / _ROOMY_M)
        sources, targets, costs = [], [], []
        for row, col, length in ((1, 0, 1.0), (0, 1, 1.0), (1, 1, math.sqrt(2)), (1, -1, math.sqrt(2))):
            other = index[self.cells[:, 0] + 1 + row, self.cells[:, 1] + 1 + col]
            here = np.flatnonzero(other >= 0)
            sources.append(here)
            targets.append(other[here])
            costs.append(length * self.cell_m * (narrow[here] + narrow[other[here]]) / 2)
        size = len(self.cells)
        rows, columns = np.concatenate(sources), np.concatenate(targets)
        return csr_matrix((np.concatenate(costs), (rows, columns)), (size, size))

    def destinations(
        self, rng: np.random.Generator
    ) -> tuple[Int[np.ndarray, "D"], Float[np.ndarray, "D N"], Int[np.ndarray, "D N"]]:
        """Cells spread over the ground, away from things where there is a choice, and the ways from them.

        Returns:
            (cells, cost from each to every cell, the cell before on the way there).
        """
        count = int(np.clip(len(self.cells) * self.cell_m**2 / _DESTINATION_EVERY_M2, 3, _MAX_DESTINATIONS))
        roomy = np.flatnonzero(self.room >= min(0.6, np.quantile(self.room, 0.5)))
        chosen, costs, befores = [int(rng.choice(roomy))], [], []
        distance = np.full(len(roomy), np.inf)
        while True:
            cost, before = dijkstra(self.graph, directed=False, indices=chosen[-1], return_predecessors=True)
            costs.append(cost)
            befores.append(before.astype(np.int64))
            distance = np.minimum(distance, cost[roomy])
            if len(chosen) == count or distance.max() < 2 * _SAME_PLACE_M:
                return np.array(chosen), np.array(costs), np.array(befores)
            # Far from all before, as one walks, at random among the far ones: no room is forgotten.
            far = np.flatnonzero(distance >= 0.8 * distance.max())
            chosen.append(int(roomy[rng.choice(far)]))


def walk_net(
    rng: np.random.Generator,
    plan: FloorPlan,
    area: Area,
    near: tuple[float, float],
    cell_m: float = 0.2,
    ground: Ground | None = None,
) -> WalkNet:
    """A net of places over the part of an area that can be walked to from `near`.

    Places are spread over the ground and joined along shortest ways that prefer the middle; a way round a corner gets
    places of its own, so that every link is straight and free.

    Args:
        rng: chooses the places.
        plan: what stands there.
        area: where to look.
        near: a place in the part to cover; the robot's start.
        cell_m: of the grid that ways are found on.
        ground: tells which points are places to be; None: all that are free.

    Raises:
        ValueError: if there is no room to walk.
    """
    cells = _Cells(plan, area, cell_m, near, ground)
    destinations, cost, before = cells.destinations(rng)
    between = cost[:, destinations]
    net = _Net(plan)
    for a, b in _pairs(between):
        way = [int(destinations[b])]
        while way[-1] != destinations[a]:
            way.append(int(before[a, way[-1]]))
        net.add_way(cells.points[way], cells.room[way])
    return net.finished(area)


def _centred(
    plan: FloorPlan, points: Float[np.ndarray, "N 2"], room: Float[np.ndarray, "N"]
) -> tuple[Float[np.ndarray, "N 2"], Float[np.ndarray, "N"]]:
    """The points of a way, those in narrow places moved by up to .12 m to where there is most room; and their room."""
    narrow = np.flatnonzero(room < 0.5)
    steps = np.stack(np.meshgrid(*[np.linspace(-0.12, 0.12, 5)] * 2), axis=-1).reshape(-1, 2)
    tried = points[narrow, None] + steps
    clear = clearances_m(plan, tried.reshape(-1, 2), _ROOMY_M, FOR_PEOPLE).reshape(len(narrow), len(steps))
    best = clear.argmax(axis=1)
    points, room = points.copy(), room.copy()
    points[narrow], room[narrow] = tried[np.arange(len(narrow)), best], clear.max(axis=1, initial=0.0)
    return points, room


def _pairs(between: Float[np.ndarray, "D D"]) -> list[tuple[int, int]]:
    """Which destinations to join: first all in one piece (Kruskal), then each to its nearest."""
    count = len(between)
    nearest = np.argsort(between, axis=1)[:, 1 : 1 + _NEIGHBOURS]
    order = sorted((float(between[a, b]), a, b) for a in range(count) for b in range(a))
    piece, pairs, more = list(range(count)), [], []
    for _, a, b in order:
        if piece[a] != piece[b]:
            piece = [piece[a] if p == piece[b] else p for p in piece]
            pairs.append((a, b))
        elif b in nearest[a] or a in nearest[b]:
            more.append((a, b))
    return pairs + more


class _Net:
    def __init__(self, plan: FloorPlan) -> None:
        self._plan = plan
        self._places: list[tuple[float, float]] = []
        self._spread: list[float] = []
        self._links: list[list[int]] = []

    def add_way(self, points: Float[np.ndarray, "N 2"], room: Float[np.ndarray, "N"]) -> None:
        """Links the ends of a way of grid cells, with as few places between as keep every link straight and free."""
        points, room = _centred(self._plan, points, room)
        stops, at = [0], 0
        while at < len(points) - 1:
            end = self._farthest(points, at, _COMFORTABLE_M)
            at = end if end > at + _SHORT_CELLS else max(end, self._farthest(points, at, BODY_ROOM_M))
            stops.append(at)
        before = self._place(points[0], float(room[0]))
        for k, after in pairwise([*stops[1:], None]):
            assert k is not None
            here = self._place(points[k], float(room[k]), before, None if after is None else points[after])
            self._link(before, here)
            before = here

    def _farthest(self, points: Float[np.ndarray, "N 2"], at: int, room_m: float) -> int:
        """How far along a way one sees from its point `at`, or nearly."""
        end = len(points) - 1
        while end > at + 1 and not way_is_clear(self._plan, points[at], points[end], (room_m, room_m)):
            end = max(at + 1, end - max(1, (end - at) // 6))
        return end

    def _place(self, point: np.ndarray, room: float, before: int | None = None, after: np.ndarray | None = None) -> int:
        """A place at a point of a way: one that is there, if the way may as well lead over it, or a new one."""
        here = (float(point[0]), float(point[1]))
        if here in self._places:
            return self._places.index(here)
        for k, place in enumerate(self._places):
            joins = math.dist(place, here) < _SAME_PLACE_M and len(self._links[k]) < NET_LINKS - 1
            if not joins or before is None or after is None or not self._clear(k, after):
                continue
            if k == before or self._clear(k, self._places[before]):
                return k
        self._places.append(here)
        self._spread.append(min(max(room - BODY_ROOM_M - 0.1, 0.0), _SPREAD_M))
        self._links.append([])
        return len(self._places) - 1

    def _clear(self, k: int, point: Point) -> bool:
        return way_is_clear(self._plan, self._places[k], point, (BODY_ROOM_M, BODY_ROOM_M))

    def _link(self, a: int, b: int) -> None:
        full = max(len(self._links[a]), len(self._links[b])) >= NET_LINKS
        if a == b or b in self._links[a] or full or not self._clear(a, self._places[b]):
            return
        self._links[a].append(b)
        self._links[b].append(a)
        # Everybody heads for a point of their own: the whole band between the two places must be free.
        for _ in range(6):
            room = (BODY_ROOM_M + self._spread[a], BODY_ROOM_M + self._spread[b])
            if way_is_clear(self._plan, self._places[a], self._places[b], room):
                return
            self._spread[a] *= 0.6
            self._spread[b] *= 0.6
        self._spread[a] = self._spread[b] = 0.0

    def finished(self, area: Area) -> WalkNet:
        """The largest connected part, cut to what a world has room for."""
        best: list[int] = []
        for first in range(len(self._places)):
            if first in best:
                continue
            part = [first]
            for k in part:
                part += [other for other in self._links[k] if other not in part]
            part = part[:NET_PLACES]
            if len(part) > len(best):
                best = part
        if len(best) < 2:
            raise ValueError(f"no two places in sight of each other for people to walk between in {area}")
        number = {k: n for n, k in enumerate(best)}
        links = np.full((len(best), NET_LINKS), -1)
        for k in best:
            row = [number[other] for other in self._links[k] if other in number]
            links[number[k], : len(row)] = row
        places = np.array([(*self._places[k], self._spread[k]) for k in best], np.float64)
        return WalkNet(places, links)
