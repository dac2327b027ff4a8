"""Who is near whom: people sorted into square cells, so that looking around costs the same in a crowd of any size.

Everything depends on the people who are there alone, not on how many slots a world has: the same seed gives the same
bits in any batch.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from densecavoid.sim._jit import inner, kernel, views
from densecavoid.sim.geometry import (
    BOX_COS,
    BOX_HALF_LENGTH,
    BOX_HALF_WIDTH,
    BOX_SIN,
    BOX_X,
    BOX_Y,
    BOX_Z_MAX,
    BOX_Z_MIN,
    CYL_RADIUS,
    CYL_X,
    CYL_Y,
    CYL_Z_MAX,
    CYL_Z_MIN,
    disc_offset,
    rectangle_offset,
)
from densecavoid.sim.people import ABSENT, PARTS, STANDING, STEP_OVER_M, WALK_UNDER_M, half_depth

CELL_M = 2.5
FEW = 24
"""So many people are all looked at: sorting them would cost more."""

MAX_THINGS = 12
"""Of so many things near them people think; they are kept out of any number."""
THINGS_M = 1.5
"""So far from the body a thing is near."""


class Scene(NamedTuple):
    """The people of one world as the motion models see them, and what stands around them. Views of the state."""

    pos: np.ndarray  # f64 [P, 2]
    vel: np.ndarray  # f64 [P, 2]
    heading: np.ndarray  # f64 [P]
    radius: np.ndarray  # f64 [P]
    preferred_speed: np.ndarray  # f64 [P]
    behaviour: np.ndarray  # i8 [P]
    attitude: np.ndarray  # i8 [P]
    boxes: np.ndarray  # f32 [n, 8]
    pillars: np.ndarray  # f32 [m, 5]
    robot: np.ndarray  # f64 [5] x, y, velocity x, y, radius


@kernel
def walks(behaviour):
    """Whether a person is there and moves by themselves."""
    return behaviour != ABSENT and behaviour != STANDING


@kernel
def shoulder_line(heading, radius):
    """Half of the segment across the heading that a body is thickened from: its x and y."""
    half_length = radius - half_depth(radius)
    return -math.sin(heading) * half_length, math.cos(heading) * half_length


class Scratch(NamedTuple):
    """What the people of one world are computed in, used again for the next world."""

    intended: np.ndarray  # f64 [P, 2] where each wants to go, m/s
    velocity: np.ndarray  # f64 [P, 2] where each will go
    before: np.ndarray  # f64 [P, 3] where each was, and the heading
    turn: np.ndarray  # f64 [P] rad by which each turns their shoulders out of the way they go
    held: np.ndarray  # bool [P] whether things stopped each from being pushed farther
    near: np.ndarray  # i64 [P] the people around one
    seen: np.ndarray  # f64 [P + 1, 8] what a model notes of each of them, and of the robot
    things: np.ndarray  # i64 [P, MAX_THINGS] what stands near each: boxes, then pillars
    num_things: np.ndarray  # i64 [P] how much
    shoulder: np.ndarray  # f64 [P, 2] of each (`shoulder_line`)
    order: np.ndarray  # i64 [P] the people who are there, cell by cell
    place: np.ndarray  # f64 [P, 2] where they were when they were sorted, in that order
    cell: np.ndarray  # i64 [P] of each slot
    cell_start: np.ndarray  # i64 [4 P + 2] first in `order` of each cell
    grid: np.ndarray  # i64 [3] cells along x and y, and how many people stand
    walls: np.ndarray  # f64 [MAX_THINGS, 3] what a model notes of the things near one person
    robot: np.ndarray  # f64 [5] x, y, velocity x, y, radius


@views
def make_scratch(num_people):
    """Room for so many people."""
    return Scratch(
        np.zeros((num_people, 2)),
        np.zeros((num_people, 2)),
        np.zeros((num_people, 3)),
        np.zeros(num_people),
        np.zeros(num_people, np.bool_),
        np.zeros(num_people, np.int64),
        np.zeros((num_people + 1, 8)),
        np.zeros((num_people, MAX_THINGS), np.int64),
        np.zeros(num_people, np.int64),
        np.zeros((num_people, 2)),
        np.zeros(num_people, np.int64),
        np.zeros((num_people, 2)),
        np.zeros(num_people, np.int64),
        np.zeros(4 * num_people + 2, np.int64),
        np.ones(3, np.int64),
        np.zeros((MAX_THINGS, 3)),
        np.zeros(5),
    )


@views
def scene_of(state, b, scratch):
    """World b as its people see it: views, so that it stays true while they move."""
    return Scene(
        state.pos[b],
        state.vel[b],
        state.heading[b],
        state.radius[b],
        state.preferred_speed[b],
        state.behaviour[b],
        state.attitude[b],
        state.boxes[b, : state.num_boxes[b]],
        state.cylinders[b, PARTS * state.pos.shape[1] : state.num_cylinders[b]],
        scratch.robot,
    )


@inner
def see_robot(state, b, scratch, radius):
    """Notes where the robot is and how it moves."""
    yaw, speed, robot = state.robot_pose[b, 2], state.robot_velocity[b, 0], scratch.robot
    robot[0], robot[1], robot[4] = state.robot_pose[b, 0], state.robot_pose[b, 1], radius
    robot[2], robot[3] = speed * math.cos(yaw), speed * math.sin(yaw)


@inner
def look_up(scene, scratch):
    """Sorts the people who are there into cells (counting sort, by slot within a cell), and notes their shoulders."""
    pos, num_people, count, standing = scene.pos, len(scene.pos), 0, 0
    x_min, y_min, x_max, y_max = np.inf, np.inf, -np.inf, -np.inf
    for i in range(num_people):
        if scene.behaviour[i] != ABSENT:
            count += 1
            standing += 1 if scene.behaviour[i] == STANDING else 0
            x_min, x_max = min(x_min, pos[i, 0]), max(x_max, pos[i, 0])
            y_min, y_max = min(y_min, pos[i, 1]), max(y_max, pos[i, 1])
            scratch.shoulder[i, 0], scratch.shoulder[i, 1] = shoulder_line(scene.heading[i], scene.radius[i])
    columns, rows, size = 1, 1, CELL_M
    if count > FEW:
        # Cells of people far apart grow, so that there are never more than about three a person.
        size = max(
            size, math.sqrt((x_max - x_min) * (y_max - y_min) / count), max(x_max - x_min, y_max - y_min) / count
        )
        columns, rows = int((x_max - x_min) / size) + 1, int((y_max - y_min) / size) + 1
    scratch.grid[0], scratch.grid[1], scratch.grid[2] = columns, rows, standing
    start = scratch.cell_start
    start[: columns * rows + 1] = 0
    for i in range(num_people):
        if scene.behaviour[i] != ABSENT:
            cell = 0
            if count > FEW:
                cell = int((pos[i, 1] - y_min) / size) * columns + int((pos[i, 0] - x_min) / size)
            scratch.cell[i] = cell
            start[cell + 1] += 1
    for cell in range(columns * rows):
        start[cell + 1] += start[cell]
    for i in range(num_people - 1, -1, -1):
        if scene.behaviour[i] != ABSENT:
            start[scratch.cell[i] + 1] -= 1
            k = start[scratch.cell[i] + 1]
            scratch.order[k] = i
            scratch.place[k, 0], scratch.place[k, 1] = pos[i, 0], pos[i, 1]
    # Filling from the back has turned the end of each cell into its start, one place to the right.
    for cell in range(columns * rows):
        start[cell] = start[cell + 1]
    start[columns * rows] = count


@inner
def collect(i, x, y, scratch, radius):
    """Writes who was within `radius` of (x, y) when people were sorted into `scratch.near`; how many those are.

    Person i, who stood in the cell of (x, y) then, is left out.
    """
    radius_2, count = radius * radius, 0
    columns, rows = scratch.grid[0], scratch.grid[1]
    reach = 1 if radius <= CELL_M else math.ceil(radius / CELL_M)
    row, column = scratch.cell[i] // columns, scratch.cell[i] % columns
    left, right = max(column - reach, 0), min(column + reach, columns - 1) + 1
    for r in range(max(row - reach, 0), min(row + reach, rows - 1) + 1):
        for k in range(scratch.cell_start[r * columns + left], scratch.cell_start[r * columns + right]):
            off_x, off_y = scratch.place[k, 0] - x, scratch.place[k, 1] - y
            if off_x * off_x + off_y * off_y < radius_2 and scratch.order[k] != i:
                scratch.near[count] = scratch.order[k]
                count += 1
    return count


@inner
def far_from_box(x, y, box, margin):
    """Whether a point is surely farther than `margin` from a box, or people walk over or under it."""
    if box[BOX_Z_MAX] <= STEP_OVER_M or box[BOX_Z_MIN] >= WALK_UNDER_M:
        return True
    cos, sin = abs(box[BOX_COS]), abs(box[BOX_SIN])
    half_length, half_width = box[BOX_HALF_LENGTH], box[BOX_HALF_WIDTH]
    return (
        abs(x - box[BOX_X]) > cos * half_length + sin * half_width + margin
        or abs(y - box[BOX_Y]) > sin * half_length + cos * half_width + margin
    )


@inner
def far_from_cylinder(x, y, cylinder, margin):
    """The same of a cylinder."""
    if cylinder[CYL_Z_MAX] <= STEP_OVER_M or cylinder[CYL_Z_MIN] >= WALK_UNDER_M:
        return True
    reach = cylinder[CYL_RADIUS] + margin
    return abs(x - cylinder[CYL_X]) > reach or abs(y - cylinder[CYL_Y]) > reach


@inner
def find_things(scene, scratch, anew):
    """Notes the things that stand near each person who walks, or, unless `anew`, who has only now begun to."""
    boxes, pillars = scene.boxes, scene.pillars
    for i in range(len(scene.pos)):
        if anew:
            scratch.num_things[i] = -1
        if scratch.num_things[i] >= 0 or not walks(scene.behaviour[i]):
            continue
        x, y, margin, count = scene.pos[i, 0], scene.pos[i, 1], scene.radius[i] + THINGS_M, 0
        for k in range(len(boxes)):
            if not far_from_box(x, y, boxes[k], margin):
                if count < MAX_THINGS:
                    scratch.things[i, count] = k
                count += 1
        for k in range(len(pillars)):
            if not far_from_cylinder(x, y, pillars[k], margin):
                if count < MAX_THINGS:
                    scratch.things[i, count] = len(boxes) + k
                count += 1
        scratch.num_things[i] = count


@inner
def thing_offset(x, y, boxes, pillars, k):
    """Signed distance from a point to a thing's surface, and the outward unit normal there."""
    if k < len(boxes):
        return rectangle_offset(x, y, boxes[k])
    return disc_offset(x, y, pillars[k - len(boxes)])
