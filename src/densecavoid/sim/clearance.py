"""How far places are from things, and whether a world can begin: nobody starts inside a thing or another body."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from densecavoid.frames import RobotConfig
from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.crowds.contact import stadium_gap
from densecavoid.sim.crowds.neighbours import shoulder_line
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.geometry import (
    BOX_HALF_LENGTH,
    BOX_HALF_WIDTH,
    BOX_X,
    BOX_Y,
    BOX_Z_MAX,
    BOX_Z_MIN,
    CYL_Z_MAX,
    CYL_Z_MIN,
    disc_offset,
    rectangle_offset,
)
from densecavoid.sim.mesh_contact import lessen_by_meshes
from densecavoid.sim.people import STEP_OVER_M, WALK_UNDER_M, half_depth
from densecavoid.sim.spec import WorldSpec

Heights = tuple[float, float]
"""What reaches above the first and begins below the second counts (m)."""
FOR_ROBOT: Heights = (0.0, RobotConfig().height_m)
FOR_PEOPLE: Heights = (STEP_OVER_M, WALK_UNDER_M)

_FAR_M = 10.0
_TOUCH_M = 0.005  # bodies and things may touch: float32 and rounded files


@inner
def nearest_thing(x, y, boxes, cylinders, low, high, limit):
    """Distance from a point to the nearest thing that reaches above `low` and begins below `high`, at most `limit`."""
    nearest = limit
    for k in range(boxes.shape[0]):
        box = boxes[k]
        reach = box[BOX_HALF_LENGTH] + box[BOX_HALF_WIDTH] + nearest
        if abs(x - box[BOX_X]) > reach or abs(y - box[BOX_Y]) > reach:
            continue
        if box[BOX_Z_MAX] > low and box[BOX_Z_MIN] < high:
            distance, _, _ = rectangle_offset(x, y, box)
            nearest = min(nearest, distance)
    for k in range(cylinders.shape[0]):
        if cylinders[k, CYL_Z_MAX] > low and cylinders[k, CYL_Z_MIN] < high:
            distance, _, _ = disc_offset(x, y, cylinders[k])
            nearest = min(nearest, distance)
    return nearest


@kernel
def _clearances(points, boxes, cylinders, low, high, limit, out):
    """Distance from each point [N, 2] to the nearest thing that reaches above `low` and begins below `high` (m).

    Negative inside, at most `limit`; written to `out` [N].
    """
    for n in range(points.shape[0]):
        out[n] = nearest_thing(points[n, 0], points[n, 1], boxes, cylinders, low, high, limit)


def clearances_m(
    plan: FloorPlan, points: Float[np.ndarray, "N 2"], limit_m: float = _FAR_M, heights: Heights = FOR_ROBOT
) -> Float[np.ndarray, "N"]:
    """Distance from each point to the nearest thing in the plan (negative inside); at most `limit_m`."""
    packed, points, out = plan.packed(), np.asarray(points, np.float64), np.empty(len(points))
    _clearances(points, packed.boxes, packed.cylinders, *heights, limit_m, out)
    lessen_by_meshes(plan.meshes, points, *heights, out)
    return out


@kernel
def nearest_pair(pos, radius, heading):
    """The two bodies [P, 2] with the least gap between their outlines: (gap, one, other); (inf, -1, -1) of fewer."""
    least, first, second = np.inf, -1, -1
    for i in range(pos.shape[0]):
        ax, ay = shoulder_line(heading[i], radius[i])
        for j in range(i):
            off_x, off_y, reach = (
                pos[i, 0] - pos[j, 0],
                pos[i, 1] - pos[j, 1],
                radius[i] + radius[j] + min(least, _FAR_M),
            )
            if off_x * off_x + off_y * off_y > reach * reach:
                continue
            bx, by = shoulder_line(heading[j], radius[j])
            gap, _, _ = stadium_gap(off_x, off_y, ax, ay, bx, by, half_depth(radius[i]) + half_depth(radius[j]))
            if gap < least:
                least, first, second = gap, j, i
    return least, first, second


def check_can_begin(spec: WorldSpec, robot_height_m: float) -> None:
    """Refuses a world in which somebody would start where there is no room.

    The robot needs its collision distance at the start and at the goal, to everything that begins below its height.
    People need their body's radius to everything that they neither step over nor walk under, and to each other; those
    who appear later only to each other. Recorded people are taken as they are.

    Raises:
        ValueError: naming the scenario, who it is and where.
    """
    crowd, need = spec.crowd, spec.collision_distance_m
    ends = np.array([spec.start_pose[:2], spec.goal], np.float64)
    room = clearances_m(spec.floor_plan, ends, heights=(0.0, robot_height_m))
    for name, (x, y), free in zip(("start", "goal"), ends.tolist(), room.tolist(), strict=True):
        if free < need - _TOUCH_M:
            raise ValueError(
                f"{spec.scenario}: the robot's {name} at ({x:.2f}, {y:.2f}) is {free:.2f} m from the nearest thing, "
                f"expected at least {need} m"
            )
    if crowd.size == 0:
        return
    pos, radius = np.asarray(crowd.pos, np.float64), np.asarray(crowd.radius_m, np.float64)
    gap, first, second = nearest_pair(pos, radius, np.asarray(crowd.first_heading_rad, np.float64))
    if gap < -_TOUCH_M:
        raise ValueError(
            f"{spec.scenario}: persons {first} at {_place(pos[first])} and {second} at {_place(pos[second])} overlap "
            f"by {-gap:.2f} m"
        )
    if spec.appearance is not None:
        return
    room = clearances_m(spec.floor_plan, pos, heights=FOR_PEOPLE)
    worst = int(np.argmin(room - radius))
    if room[worst] < radius[worst] - _TOUCH_M:
        raise ValueError(
            f"{spec.scenario}: person {worst} at {_place(pos[worst])} is {room[worst]:.2f} m from the nearest thing, "
            f"expected at least the body's radius, {radius[worst]:.2f} m"
        )
    to_robot = np.hypot(pos[:, 0] - ends[0, 0], pos[:, 1] - ends[0, 1]) - radius
    worst = int(np.argmin(to_robot))
    if to_robot[worst] < need - _TOUCH_M:
        raise ValueError(
            f"{spec.scenario}: person {worst} at {_place(pos[worst])} is {to_robot[worst]:.2f} m from the robot's "
            f"start, expected at least {need} m"
        )


def _place(point: np.ndarray) -> str:
    return f"({point[0]:.2f}, {point[1]:.2f})"
