"""How a person turns an intended velocity into motion: anticipating others, keeping off walls, never overlapping.

The avoidance of others is the power law of anticipation, E(tau) = k tau^-2 exp(-tau/tau0) (Karamouzas, Skinner, Guy,
Phys. Rev. Lett. 2014), a force along the offset that two bodies will have when they touch.
"""

from __future__ import annotations

import math

from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.geometry import (
    BOX_HALF_LENGTH,
    BOX_HALF_WIDTH,
    BOX_X,
    BOX_Y,
    BOX_Z_MAX,
    BOX_Z_MIN,
    CYL_RADIUS,
    CYL_Z_MAX,
    CYL_Z_MIN,
    disc_offset,
    rectangle_offset,
)
from densecavoid.sim.people import ABSENT, PARTS, STANDING, STEP_OVER_M, WALK_UNDER_M, advance_gait

_RELAXATION_S = 0.5  # to the intended velocity (Helbing-Molnar's tau)
_ANTICIPATION_GAIN = 1.5  # k of the power law
_ANTICIPATION_HORIZON_S = 3.0  # tau0 of the power law
_HORIZON_S = 8.0  # collisions later than this are not thought of
_ELBOW_ROOM_M = 0.05  # people keep this between bodies when they can
_ROBOT_ROOM_M = 0.15  # and this to a robot that they notice
_ROBOT_GAP_M = 0.05  # nearer than this they do not step
_MAX_ACCELERATION = 4.0  # m/s2
_WALL_FORCE = 3.0  # m/s2 at the surface
_WALL_RANGE_M = 0.15
_OVERSPEED = 1.3  # the greatest speed as a multiple of the preferred one


@kernel
def anticipation_force(offset_x, offset_y, approach_x, approach_y, reach):
    """Acceleration on a person whose neighbour's centre is at `offset`, while the gap closes with `approach` (m/s).

    `reach` is the distance at which the two touch. Zero when they will not.
    """
    speed_2 = approach_x * approach_x + approach_y * approach_y
    closing = offset_x * approach_x + offset_y * approach_y
    gap = offset_x * offset_x + offset_y * offset_y - reach * reach
    if gap <= 0.0:  # already closer than they like: straight apart
        distance = max(math.sqrt(offset_x * offset_x + offset_y * offset_y), 1e-6)
        return -_MAX_ACCELERATION * offset_x / distance, -_MAX_ACCELERATION * offset_y / distance
    discriminant = closing * closing - speed_2 * gap
    if closing <= 0.0 or discriminant <= 1e-9 or speed_2 < 1e-9:
        return 0.0, 0.0
    root = math.sqrt(discriminant)
    tau = (closing - root) / speed_2
    if tau > _HORIZON_S:
        return 0.0, 0.0
    tau = max(tau, 0.05)
    size = _ANTICIPATION_GAIN * math.exp(-tau / _ANTICIPATION_HORIZON_S) / (tau * tau)
    size *= (2.0 / tau + 1.0 / _ANTICIPATION_HORIZON_S) / root
    force_x = -size * (offset_x - approach_x * tau)
    force_y = -size * (offset_y - approach_y * tau)
    strength = math.sqrt(force_x * force_x + force_y * force_y)
    if strength > _MAX_ACCELERATION:
        force_x *= _MAX_ACCELERATION / strength
        force_y *= _MAX_ACCELERATION / strength
    return force_x, force_y


@inner
def _social_force(state, b, i, robot_radius):
    """Acceleration on person i from everybody else (and the robot, if they notice it)."""
    x, y = state.pos[b, i, 0], state.pos[b, i, 1]
    vx, vy = state.vel[b, i, 0], state.vel[b, i, 1]
    total_x, total_y = 0.0, 0.0
    for j in range(state.pos.shape[1]):
        if j == i or state.behaviour[b, j] == ABSENT:
            continue
        off_x, off_y = state.pos[b, j, 0] - x, state.pos[b, j, 1] - y
        if off_x * off_x + off_y * off_y > 36.0:
            continue
        reach = state.radius[b, i] + state.radius[b, j] + _ELBOW_ROOM_M
        fx, fy = anticipation_force(off_x, off_y, vx - state.vel[b, j, 0], vy - state.vel[b, j, 1], reach)
        total_x += fx
        total_y += fy
    if state.notices_robot[b, i]:
        pose = state.robot_pose[b]
        speed = state.robot_velocity[b, 0]
        reach = state.radius[b, i] + robot_radius + _ROBOT_ROOM_M
        fx, fy = anticipation_force(
            pose[0] - x, pose[1] - y, vx - speed * math.cos(pose[2]), vy - speed * math.sin(pose[2]), reach
        )
        total_x += fx
        total_y += fy
    return total_x, total_y


@inner
def _wall_force(state, b, i):
    """Acceleration on person i away from what stands near."""
    x, y, radius = state.pos[b, i, 0], state.pos[b, i, 1], state.radius[b, i]
    total_x, total_y = 0.0, 0.0
    for k in range(state.num_boxes[b]):
        box = state.boxes[b, k]
        if _far_from_box(x, y, box, radius + 1.0):
            continue
        distance, normal_x, normal_y = rectangle_offset(x, y, box)
        size = _WALL_FORCE * math.exp(-(distance - radius) / _WALL_RANGE_M) if distance - radius < 0.6 else 0.0
        total_x += size * normal_x
        total_y += size * normal_y
    for k in range(PARTS * state.pos.shape[1], state.num_cylinders[b]):
        if _over_or_under(state.cylinders[b, k]):
            continue
        distance, normal_x, normal_y = disc_offset(x, y, state.cylinders[b, k])
        size = _WALL_FORCE * math.exp(-(distance - radius) / _WALL_RANGE_M) if distance - radius < 0.6 else 0.0
        total_x += size * normal_x
        total_y += size * normal_y
    return total_x, total_y


@kernel
def _far_from_box(x, y, box, margin):
    """Whether a box is out of reach, or so low or high that people walk over or under it."""
    reach = box[BOX_HALF_LENGTH] + box[BOX_HALF_WIDTH] + margin
    far = abs(x - box[BOX_X]) > reach or abs(y - box[BOX_Y]) > reach
    return far or box[BOX_Z_MAX] <= STEP_OVER_M or box[BOX_Z_MIN] >= WALK_UNDER_M


@kernel
def _over_or_under(cylinder):
    return cylinder[CYL_Z_MAX] <= STEP_OVER_M or cylinder[CYL_Z_MIN] >= WALK_UNDER_M


@inner
def _part_bodies(state, b):
    """Moves overlapping people apart, half each; who stands does not give way."""
    for i in range(state.pos.shape[1]):
        if state.behaviour[b, i] == ABSENT:
            continue
        for j in range(i):
            if state.behaviour[b, j] == ABSENT:
                continue
            off_x, off_y = state.pos[b, i, 0] - state.pos[b, j, 0], state.pos[b, i, 1] - state.pos[b, j, 1]
            reach = state.radius[b, i] + state.radius[b, j]
            distance_2 = off_x * off_x + off_y * off_y
            if distance_2 >= reach * reach:
                continue
            distance = math.sqrt(distance_2)
            if distance < 1e-6:
                off_x, off_y, distance = 1.0, 0.0, 1.0
                overlap = reach
            else:
                overlap = reach - distance
            i_moves = state.behaviour[b, i] != STANDING
            j_moves = state.behaviour[b, j] != STANDING
            share = 0.5 if i_moves and j_moves else 1.0
            if i_moves:
                state.pos[b, i, 0] += share * overlap * off_x / distance
                state.pos[b, i, 1] += share * overlap * off_y / distance
            if j_moves:
                state.pos[b, j, 0] -= share * overlap * off_x / distance
                state.pos[b, j, 1] -= share * overlap * off_y / distance


@inner
def _keep_out_of_things(state, b, i, robot_radius):
    """Moves person i out of walls, furniture and pillars, and off a robot that they notice."""
    radius = state.radius[b, i]
    if state.notices_robot[b, i]:
        off_x = state.pos[b, i, 0] - state.robot_pose[b, 0]
        off_y = state.pos[b, i, 1] - state.robot_pose[b, 1]
        distance, reach = math.sqrt(off_x * off_x + off_y * off_y), radius + robot_radius + _ROBOT_GAP_M
        if 1e-6 < distance < reach:
            state.pos[b, i, 0] += (reach - distance) * off_x / distance
            state.pos[b, i, 1] += (reach - distance) * off_y / distance
    for k in range(state.num_boxes[b]):
        box = state.boxes[b, k]
        if _far_from_box(state.pos[b, i, 0], state.pos[b, i, 1], box, radius):
            continue
        distance, normal_x, normal_y = rectangle_offset(state.pos[b, i, 0], state.pos[b, i, 1], box)
        if distance < radius:
            state.pos[b, i, 0] += (radius - distance) * normal_x
            state.pos[b, i, 1] += (radius - distance) * normal_y
    for k in range(PARTS * state.pos.shape[1], state.num_cylinders[b]):
        cylinder = state.cylinders[b, k]
        if cylinder[CYL_RADIUS] <= 0.0 or _over_or_under(cylinder):
            continue
        distance, normal_x, normal_y = disc_offset(state.pos[b, i, 0], state.pos[b, i, 1], cylinder)
        if distance < radius:
            state.pos[b, i, 0] += (radius - distance) * normal_x
            state.pos[b, i, 1] += (radius - distance) * normal_y


@inner
def move_people(state, b, intended, new_vel, robot_radius, dt):
    """Advances everybody in world b by `dt` s towards the intended velocities [P, 2]; `new_vel` is scratch space."""
    num_people = state.pos.shape[1]
    for i in range(num_people):
        if state.behaviour[b, i] == ABSENT or state.behaviour[b, i] == STANDING:
            continue
        social_x, social_y = _social_force(state, b, i, robot_radius)
        wall_x, wall_y = _wall_force(state, b, i)
        acc_x = (intended[i, 0] - state.vel[b, i, 0]) / _RELAXATION_S + social_x + wall_x
        acc_y = (intended[i, 1] - state.vel[b, i, 1]) / _RELAXATION_S + social_y + wall_y
        vx, vy = state.vel[b, i, 0] + acc_x * dt, state.vel[b, i, 1] + acc_y * dt
        speed = math.sqrt(vx * vx + vy * vy)
        limit = _OVERSPEED * state.preferred_speed[b, i]
        scale = limit / speed if speed > limit else 1.0
        new_vel[i, 0], new_vel[i, 1] = vx * scale, vy * scale
    for i in range(num_people):
        if state.behaviour[b, i] != ABSENT and state.behaviour[b, i] != STANDING:
            state.pos[b, i, 0] += new_vel[i, 0] * dt
            state.pos[b, i, 1] += new_vel[i, 1] * dt
            state.vel[b, i, 0], state.vel[b, i, 1] = new_vel[i, 0], new_vel[i, 1]
    _part_bodies(state, b)
    for i in range(num_people):
        if state.behaviour[b, i] != ABSENT and state.behaviour[b, i] != STANDING:
            _keep_out_of_things(state, b, i, robot_radius)
            walk(state, b, i, dt)


@inner
def walk(state, b, i, dt):
    """Turns person i the way they go and advances their stride."""
    vx, vy = state.vel[b, i, 0], state.vel[b, i, 1]
    speed = math.sqrt(vx * vx + vy * vy)
    if speed > 0.1:
        state.heading[b, i] = math.atan2(vy, vx)
    state.phase[b, i] = advance_gait(state.phase[b, i], speed, dt)
