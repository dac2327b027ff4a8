"""Dynamic programming over place, heading and the next seconds in the robot's frame: the loops of `outlook`.

The window lies ahead of the robot: it cannot reverse, so that within the horizon little behind it can be reached.
Values are those of `foresight.value_field`: 1 at the goal, a little less for each moment until then.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from densecavoid.perception.ways import raise_around
from densecavoid.sim._jit import inner, kernel

_TAKEN = 1e3
_ONE = np.float32(1.0)
SIDE_BY_SIDE = 8  # worlds that are reckoned together: then loops are long enough, and values not yet out of the cache
_SOON = 3  # moments; later there is no half speed: six commands for nine, and worths hardly change
_MOMENTS_NEAR = 3.0  # in which the robot is as near to the same person
_BESIDE_PERSON_M, _BESIDE_THING_M = 0.1, 0.02  # so far beyond a collision a command that is held begins to cost
_FARTHEST_M = 20.0  # a longer way counts so much: discounted, nothing is worth anything to who has far to go
_TURNED_ROUND = 0.6  # share of the time to turn on the spot that heading elsewhere costs: robots drive on as they turn


class Rules(NamedTuple):
    """`OutlookConfig` and the robot as the kernels read them."""

    cell_m: float
    moments: int
    hold_s: float
    discount: float  # of a moment
    slip: float
    collision: float
    body_m: float
    margin_m: float
    near_person_m: float
    near_person_risk: float
    turned_risk: float
    turned_reach: float
    near_thing_m: float
    near_thing_slower: float
    beyond_slower: float
    doubt_m_s: float
    goal_m: float
    way_cell_m: float  # of the grid of ways
    max_linear: float
    max_angular: float


class Around(NamedTuple):
    """What is known around each robot, in its frame."""

    goal: np.ndarray  # f64 [B, 2]
    points: np.ndarray  # f32 [B, N, 2] of what stands,
    num_points: np.ndarray  # i64 [B] so many
    pos: np.ndarray  # f64 [B, P, 2] people,
    vel: np.ndarray  # f64 [B, P, 2] over ground,
    radius: np.ndarray  # f64 [B, P],
    there: np.ndarray  # bool [B, P] if they are
    turns_per_s: np.ndarray  # f64 [B] how often people change their course there
    way: np.ndarray  # f32 [B, C, C] length of the way to the goal (m), from the cells of a square grid
    way_from: np.ndarray  # f64 [B, 3] pose of the robot in that grid, whose middle is (0, 0)


class Lattice(NamedTuple):
    """Places and headings that the robot is reckoned in, counted from where it is, and how it comes from one to
    another. Along x and y cells, whose middles are at (x0, y0) + (i + .5, j + .5) cell."""

    x0: float
    y0: float
    offsets: np.ndarray  # i64 [H, C, 3] cells along x and y that a held command leads to from each heading, the heading
    weights: np.ndarray  # f32 [H, C, 4] of that cell and of its neighbours ahead
    halfway: np.ndarray  # i64 [H, C, 2] cells along x and y that it passes on the way there
    num_later: int  # commands, the first ones, that are thought of from `_SOON` on
    size_y: int  # cells along y
    boxes: np.ndarray  # i64 [M + 1, 4] first and last (excluded) cells along x, and along y, of all headings
    spans: np.ndarray  # i32 [M + 1, H, X, 2] first and last (excluded) cells along y that it can be in after a moment


class Room(NamedTuple):
    """Room to work, kept from one look to the next: to ask the system for its pages took as long as to fill them.

    For each of the threads N, for W worlds side by side: in rows of Y * W, entry j * many + n is that of cell j in the
    nth of as many worlds as are looked at.
    """

    values: np.ndarray  # f32 [N, 2, H, X, Y * W] of two moments; finite wherever they are not asked for
    ground: np.ndarray  # f32 [N, W, X, Y]
    scratch: np.ndarray  # f32 [N, X, Y]
    kept: np.ndarray  # f32 [N, X, Y * W]
    risk: np.ndarray  # f32 [N, X, Y * W]
    halfway: np.ndarray  # f32 [N, X, Y * W]
    worth: np.ndarray  # f32 [N, X, Y * W]
    ahead: np.ndarray  # i32 [N, X, Y * W]
    is_goal: np.ndarray  # bool [N, X, Y * W]
    best: np.ndarray  # f32 [N, Y * W]
    total: np.ndarray  # f32 [N, Y * W]
    fade: np.ndarray  # f32 [N, H]


def make_room(lattice: Lattice, threads: int, wide: int) -> Room:
    """For so many threads, each with up to `wide` worlds at once (`SIDE_BY_SIDE` at most)."""
    _, headings, size_x, _ = lattice.spans.shape
    row = lattice.size_y * wide

    def plane(kind: type = np.float32) -> np.ndarray:
        return np.zeros((threads, size_x, row), kind)

    return Room(
        values=np.zeros((threads, 2, headings, size_x, row), np.float32),
        ground=np.zeros((threads, wide, size_x, lattice.size_y), np.float32),
        scratch=np.zeros((threads, size_x, lattice.size_y), np.float32),
        kept=plane(),
        risk=plane(),
        halfway=plane(),
        worth=plane(),
        ahead=plane(np.int32),
        is_goal=plane(np.bool_),
        best=np.zeros((threads, row), np.float32),
        total=np.zeros((threads, row), np.float32),
        fade=np.zeros((threads, headings), np.float32),
    )


@inner
def _mark_span(spans, k, h, i, first_j, last_j):
    span = spans[k, h, i]
    if span[0] >= span[1]:
        span[0], span[1] = first_j, last_j
    else:
        span[0], span[1] = min(span[0], first_j), max(span[1], last_j)


@kernel
def find_spans(spans, offsets, firsts):
    """Which cells values are asked for, after each moment: those that the robot can get to and their neighbours,
    between which values are interpolated, and what lies between them along y.

    Args:
        spans: i32 [M + 1, H, X, 2], zeros; written, as in `Lattice`. Moment 0 stays empty.
        offsets: as in `Lattice`.
        firsts: i64 [K, 3] heading, and cells along x and y, of the cells that the first commands lead to.
    """
    for n in range(firsts.shape[0]):
        h, i, j = firsts[n, 0], firsts[n, 1], firsts[n, 2]
        for ahead in range(2):
            _mark_span(spans, 1, h, i + ahead, j, j + 2)
    for k in range(1, spans.shape[0] - 1):
        for h in range(spans.shape[1]):
            for i in range(spans.shape[2]):
                first_j, last_j = spans[k, h, i]
                if first_j >= last_j:
                    continue
                for c in range(offsets.shape[1]):
                    at_i, off_j, later = i + offsets[h, c, 0], offsets[h, c, 1], offsets[h, c, 2]
                    for ahead in range(2):
                        _mark_span(spans, k + 1, later, at_i + ahead, first_j + off_j, last_j + off_j + 1)


@inner
def _end_of_ways(worth, ahead, ground, around, b, lattice, rules, one, many):
    """What it is worth to be in a cell when the horizon ends, by the way that is left, and which heading leads on.

    Args:
        worth, ahead: f32, i32 [X, Y * many], written: heading -1 where it does not matter.
        ground: f32 [X, Y] risk of being in a cell.
        one, many: which of how many worlds it is.
    """
    headings, way = lattice.spans.shape[1], around.way[b]
    cells, cell, at = way.shape[0], rules.way_cell_m, around.way_from[b]
    corner = -0.5 * cells * cell
    cos, sin = math.cos(at[2]), math.sin(at[2])
    per_s = rules.beyond_slower * math.log(rules.discount) / rules.hold_s
    here_i = min(max(int((at[0] - corner) / cell), 0), cells - 1)
    here_j = min(max(int((at[1] - corner) / cell), 0), cells - 1)
    left_out = max(way[here_i, here_j] - _FARTHEST_M, 0.0)
    first_i, last_i, first_j, last_j = lattice.boxes[rules.moments]
    for i in range(first_i, last_i):
        for j in range(first_j, last_j):
            x, y = lattice.x0 + (i + 0.5) * rules.cell_m, lattice.y0 + (j + 0.5) * rules.cell_m
            off_x, off_y = x - around.goal[b, 0], y - around.goal[b, 1]
            n = j * many + one
            ahead[i, n] = -1
            if off_x * off_x + off_y * off_y < rules.goal_m * rules.goal_m:
                worth[i, n] = np.float32(1.0)
            elif ground[i, j] >= _ONE:
                worth[i, n] = np.float32(rules.collision)
            else:
                u = (at[0] + cos * x - sin * y - corner) / cell - 0.5
                v = (at[1] + sin * x + cos * y - corner) / cell - 0.5
                at_i, at_j = min(max(int(u), 0), cells - 2), min(max(int(v), 0), cells - 2)
                u, v = u - at_i, v - at_j
                near, far = way[at_i], way[at_i + 1]
                length = (1.0 - u) * ((1.0 - v) * near[at_j] + v * near[at_j + 1])
                length += u * ((1.0 - v) * far[at_j] + v * far[at_j + 1])
                towards_x = (1.0 - v) * (near[at_j] - far[at_j]) + v * (near[at_j + 1] - far[at_j + 1])
                towards_y = (1.0 - u) * (near[at_j] - near[at_j + 1]) + u * (far[at_j] - far[at_j + 1])
                length = max(length - left_out, 0.0)
                worth[i, n] = np.float32(math.exp(per_s * length / rules.max_linear))
                ahead[i, n] = round((math.atan2(towards_y, towards_x) - at[2]) / (2.0 * math.pi) * headings) % headings


@inner
def _begin_at_the_end(values, worth, ahead, fade, lattice, rules, many):
    """Values [H, X, Y * many] when the horizon ends: from `_end_of_ways` and the turn that is left.

    Args:
        fade: f32 [H] room to work.
    """
    headings, spans = values.shape[0], lattice.spans[rules.moments]
    per_s = rules.beyond_slower * math.log(rules.discount) / rules.hold_s
    for h in range(headings):
        off = min(h, headings - h) * 2.0 * math.pi / headings
        fade[h] = math.exp(per_s * _TURNED_ROUND * off / rules.max_angular)
    for h in range(headings):
        for i in range(values.shape[1]):
            for n in range(spans[h, i, 0] * many, spans[h, i, 1] * many):
                off = h - ahead[i, n]
                off += headings if off < 0 else 0
                values[h, i, n] = worth[i, n] if ahead[i, n] < 0 else worth[i, n] * fade[off]


@kernel
def _one_moment_before(now, following, best, total, risk, halfway, kept, is_goal, k, lattice, rules, many):
    """Values [H, X, Y * many] after moment k, in the cells and headings that can be reached by then.

    Args:
        following: a moment later.
        best, total: f32 [Y * many] room to work.
        risk: f32 [X, Y * many] of a collision in a cell then,
        halfway: f32 [X, Y * many] and half a moment later, on the way to the next.
        kept: f32 [X, Y * many] what is left of a cell's value because things are near.
        is_goal: bool [X, Y * many].
        many: worlds side by side.
    """
    commands = lattice.offsets.shape[1] if k < _SOON else lattice.num_later
    meant = np.float32(rules.discount * (1.0 - rules.slip))
    spread = np.float32(rules.discount * rules.slip / commands)
    collision = np.float32(rules.collision)
    for h in range(now.shape[0]):
        for i in range(now.shape[1]):
            first, size = lattice.spans[k, h, i, 0] * many, lattice.spans[k, h, i, 1] * many
            size -= first
            if size <= 0:
                continue
            for n in range(size):
                best[n] = np.float32(-2.0)
                total[n] = np.float32(0.0)
            for c in range(commands):
                at_i, at_n = i + lattice.offsets[h, c, 0], first + lattice.offsets[h, c, 1] * many
                later = following[lattice.offsets[h, c, 2]]
                passed = halfway[i + lattice.halfway[h, c, 0], first + lattice.halfway[h, c, 1] * many :]
                w00, w01 = lattice.weights[h, c, 0], lattice.weights[h, c, 1]
                w10, w11 = lattice.weights[h, c, 2], lattice.weights[h, c, 3]
                # Slices that begin at 0: the loop over them is one of vectors.
                near, on = later[at_i, at_n:], at_n + many
                if w00 == np.float32(1.0):  # to a cell's middle
                    for n in range(size):
                        value = near[n] + passed[n] * (collision - near[n])
                        best[n] = max(best[n], value)
                        total[n] += value
                else:
                    near_on, far, far_on = later[at_i, on:], later[at_i + 1, at_n:], later[at_i + 1, on:]
                    for n in range(size):
                        value = w00 * near[n] + w01 * near_on[n] + w10 * far[n] + w11 * far_on[n]
                        value += passed[n] * (collision - value)
                        best[n] = max(best[n], value)
                        total[n] += value
            row, row_risk, row_goal = now[h, i, first:], risk[i, first:], is_goal[i, first:]
            row_kept = kept[i, first:]
            for n in range(size):
                value = (meant * best[n] + spread * total[n]) * row_kept[n]
                value = _ONE if row_goal[n] else value
                row[n] = value + row_risk[n] * (collision - value)


@inner
def _nearest_things(nearest2, around, b, path, reach):
    """Writes how near, squared, each held command's path [K, S, 3] comes to things, where that is less than `reach`."""
    for c in range(path.shape[0]):
        nearest2[c] = reach * reach
    farthest = reach
    for c in range(path.shape[0]):
        farthest = max(farthest, reach + math.hypot(path[c, -1, 0], path[c, -1, 1]))
    for n in range(around.num_points[b]):
        x, y = around.points[b, n, 0], around.points[b, n, 1]
        if x * x + y * y < farthest * farthest:
            for c in range(path.shape[0]):
                for s in range(path.shape[1]):
                    off_x, off_y = path[c, s, 0] - x, path[c, s, 1] - y
                    nearest2[c] = min(nearest2[c], off_x * off_x + off_y * off_y)


@inner
def _too_near_people(path, b, around, rules):
    """What it costs to hold a command, whose path [S, 3] is given, among people: up to what a collision does, from
    `_BESIDE_PERSON_M` beyond one."""
    worst = 0.0
    for s in range(path.shape[0]):
        time_s = rules.hold_s * (s + 1) / path.shape[0]
        for p in range(around.there.shape[1]):
            if around.there[b, p]:
                off_x = around.pos[b, p, 0] + time_s * around.vel[b, p, 0] - path[s, 0]
                off_y = around.pos[b, p, 1] + time_s * around.vel[b, p, 1] - path[s, 1]
                free = math.sqrt(off_x * off_x + off_y * off_y) - around.radius[b, p] - rules.body_m
                worst = max(worst, 1.0 - free / _BESIDE_PERSON_M)
    return -rules.collision * min(worst, 1.0)


@inner
def _mark_ground(ground, kept, is_goal, around, b, lattice, rules):
    """Writes, for one world, which cells [X, Y] are taken for good, what is left of a value beside things, and the
    goal.

    Args:
        ground: f32, rows of which lie in one piece; `kept` and `is_goal` need not.
    """
    x0, y0, cell = lattice.x0, lattice.y0, rules.cell_m
    hit = rules.body_m + rules.margin_m
    for i in range(ground.shape[0]):
        for j in range(ground.shape[1]):
            off_x = x0 + (i + 0.5) * cell - around.goal[b, 0]
            off_y = y0 + (j + 0.5) * cell - around.goal[b, 1]
            is_goal[i, j] = off_x * off_x + off_y * off_y < rules.goal_m * rules.goal_m
            kept[i, j], ground[i, j] = 1.0, 0.0
    for n in range(around.num_points[b]):
        x, y = around.points[b, n, 0], around.points[b, n, 1]
        raise_around(ground, x, y, hit, hit + rules.near_thing_m, _TAKEN, rules.near_thing_slower, x0, y0, cell)
    for i in range(ground.shape[0]):
        for j in range(ground.shape[1]):
            if is_goal[i, j]:  # whoever sets a goal beside things means it; people who stand there are another matter
                ground[i, j] = 0.0
            elif ground[i, j] < _TAKEN:
                kept[i, j] = math.exp(math.log(rules.discount) * ground[i, j])
                ground[i, j] = 0.0
            else:
                ground[i, j] = 1.0


@inner
def _mark_moment(risk, scratch, ground, k, time_s, near_risk, around, b, lattice, rules):
    """Writes how likely a collision is in one world in each cell [X, Y] at a time, where the robot can be after moment
    k.

    People go on as they do now, until they turn: the longer until then, the less surely they are where they would be,
    and the farther from it they may be. As the robot is near the same person at some moments one after the other, the
    chance is that of all of them together.

    Args:
        scratch: f32 [X, Y] room to work.
        ground: f32 [X, Y] 1 where a thing is, 0 elsewhere.
        near_risk: up to so likely a collision is beside people, however steadily they walk.
    """
    first_i, last_i, first_j, last_j = lattice.boxes[k]
    box = scratch[first_i:last_i, first_j:last_j]
    for i in range(box.shape[0]):
        for j in range(box.shape[1]):
            box[i, j] = ground[first_i + i, first_j + j]
    at = lattice.x0 + first_i * rules.cell_m, lattice.y0 + first_j * rules.cell_m, rules.cell_m
    turned = 1.0 - math.exp(-around.turns_per_s[b] * time_s)
    beside = near_risk + rules.turned_risk * turned
    inside = max(1.0 - turned ** (1.0 / _MOMENTS_NEAR), beside)
    for p in range(around.there.shape[1]):
        if around.there[b, p]:
            x = around.pos[b, p, 0] + time_s * around.vel[b, p, 0]
            y = around.pos[b, p, 1] + time_s * around.vel[b, p, 1]
            hit = around.radius[b, p] + rules.body_m + rules.margin_m
            speed = math.sqrt(around.vel[b, p, 0] ** 2 + around.vel[b, p, 1] ** 2)
            reach = hit + rules.near_person_m + (rules.doubt_m_s + rules.turned_reach * turned * speed) * time_s
            raise_around(box, x, y, hit, reach, inside, beside, *at)
    for i in range(box.shape[0]):
        for j in range(box.shape[1]):
            risk[first_i + i, first_j + j] = box[i, j]


@inner
def _weigh(out, following, around, b, lattice, path, rules, one, many):
    """What holding each command for a moment leads to, of the values after it, less what is too near on the way."""
    headings, cell, last = following.shape[0], rules.cell_m, path.shape[1] - 1
    _nearest_things(out[b], around, b, path, rules.body_m + _BESIDE_THING_M)
    for c in range(path.shape[0]):
        free = math.sqrt(out[b, c]) - rules.body_m
        lost = -rules.collision * min(1.0 - free / _BESIDE_THING_M, 1.0)
        lost = max(lost, _too_near_people(path[c], b, around, rules))
        u, v = (path[c, last, 0] - lattice.x0) / cell - 0.5, (path[c, last, 1] - lattice.y0) / cell - 0.5
        i, j, turn = int(u), int(v), path[c, last, 2] / (2.0 * math.pi) * headings
        u, v, h, n = u - i, v - j, math.floor(turn), j * many + one
        value = 0.0
        for turned in range(2):
            share, later = turn - h if turned else 1.0 - turn + h, following[(h + turned) % headings]
            value += share * (1.0 - u) * ((1.0 - v) * later[i, n] + v * later[i, n + many])
            value += share * u * ((1.0 - v) * later[i + 1, n] + v * later[i + 1, n + many])
        out[b, c] = value - lost


@kernel
def worth_of_commands(first, last, shares, room, which, around, lattice, path, rules, out):
    """What it is worth to hold each command for a moment, and then to do the best that can be foreseen.

    Args:
        first, last: of as many shares of the worlds as threads work.
        room: a `Room` of at least as many.
        which: bool [B] worlds.
        around: an `Around`.
        lattice: a `Lattice`.
        path: f64 [K, S, 3] poses on the way of each command while it is held, evenly apart, the last at the end.
        rules: a `Rules`.
        out: f32 [B, K], written.
    """
    together = np.empty(SIDE_BY_SIDE, np.int64)
    for share in range(first, last):
        following, now = room.values[share, 0], room.values[share, 1]
        ground, scratch, kept = room.ground[share], room.scratch[share], room.kept[share]
        risk, halfway = room.risk[share], room.halfway[share]
        worth, ahead, is_goal = room.worth[share], room.ahead[share], room.is_goal[share]
        best, total, fade = room.best[share], room.total[share], room.fade[share]
        at, end = len(which) * share // shares, len(which) * (share + 1) // shares
        while at < end:
            many = 0
            while at < end and many < len(ground):
                if which[at]:
                    together[many] = at
                    many += 1
                at += 1
            if many == 0:
                break
            for n in range(many):
                b = together[n]
                _mark_ground(ground[n], kept[:, n::many], is_goal[:, n::many], around, b, lattice, rules)
                _end_of_ways(worth, ahead, ground[n], around, b, lattice, rules, n, many)
            _begin_at_the_end(following, worth, ahead, fade, lattice, rules, many)
            for k in range(rules.moments - 1, 0, -1):
                for n in range(many):
                    of_world = scratch, ground[n]
                    known = around, together[n], lattice, rules
                    _mark_moment(risk[:, n::many], *of_world, k, k * rules.hold_s, rules.near_person_risk, *known)
                    _mark_moment(halfway[:, n::many], *of_world, k + 1, (k + 0.5) * rules.hold_s, 0.0, *known)
                _one_moment_before(now, following, best, total, risk, halfway, kept, is_goal, k, lattice, rules, many)
                following, now = now, following
            for n in range(many):
                _weigh(out, following, around, together[n], lattice, path, rules, n, many)
