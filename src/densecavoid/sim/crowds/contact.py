"""Bodies that touch: the outline of a person seen from above, how two of them part, and what keeps them out of things.

Shoulders are wider than deep, so the outline is a stadium: a segment across the heading, thickened by half the body's
depth. Towards walls, furniture and the robot a person keeps the whole half shoulder width, so that turning on the spot
never brings a shoulder into a wall. Here people are moved, not steered.
"""

from __future__ import annotations

import math

from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.crowds.neighbours import MAX_THINGS, collect, shoulder_line, thing_offset
from densecavoid.sim.people import ABSENT, STANDING, half_depth

ROBOT_GAP_M = 0.05
"""Nearer than this to the robot nobody steps who notices it."""
MAX_RADIUS_M = 0.45
"""Nobody is wider than twice this (`Crowd` refuses them): bodies farther apart than that do not touch."""
_SWEEPS = 2  # over all pairs, before things have their say
_MAX_STEP_M = 0.2  # by walking and being pushed: less than the radius, so that nobody is pushed through a wall
_TOUCH_M = 1e-4
_GIVE_RAD = 0.1  # by which somebody held turns a shoulder out of another's way, each time


@inner
def _clamped(value):
    return min(max(value, -1.0), 1.0)


@kernel
def stadium_gap(off_x, off_y, ax, ay, bx, by, thickness):
    """Gap between two bodies (negative: overlap), and the unit normal towards the first.

    Args:
        off_x, off_y: from the second centre to the first.
        ax, ay: the first body's half segment (`shoulder_line`); bx, by: the second's.
        thickness: sum of their half depths.
    """
    # Nearest points off + s a and t b of two segments, s and t in [-1, 1] (Ericson, Real-Time Collision Detection,
    # 5.1.9).
    aa, bb, ab = ax * ax + ay * ay, bx * bx + by * by, ax * bx + ay * by
    a_off, b_off = ax * off_x + ay * off_y, bx * off_x + by * off_y
    denominator = aa * bb - ab * ab
    s = _clamped((ab * b_off - bb * a_off) / denominator) if denominator > 1e-9 * aa * bb else 0.0
    t = (ab * s + b_off) / bb
    if abs(t) > 1.0 or denominator <= 1e-9 * aa * bb:
        t = _clamped(t)
        s = _clamped((ab * t - a_off) / aa)
        t = _clamped((ab * s + b_off) / bb)
    x, y = off_x + s * ax - t * bx, off_y + s * ay - t * by
    distance = math.sqrt(x * x + y * y)
    if distance > 1e-6:
        return distance - thickness, x / distance, y / distance
    length = math.sqrt(off_x * off_x + off_y * off_y)  # the segments cross: apart the way the centres are
    if length > 1e-6:
        return -thickness - length, off_x / length, off_y / length
    return -thickness, 1.0, 0.0


@inner
def _stop_at(vel, x, y):
    """Takes away the velocity against a surface with the unit normal (x, y)."""
    into = vel[0] * x + vel[1] * y
    if into < 0.0:
        vel[0] -= into * x
        vel[1] -= into * y


@inner
def _push(pos, vel, x, y, overlap):
    """Moves a person by `overlap` along the unit normal."""
    pos[0] += overlap * x
    pos[1] += overlap * y
    _stop_at(vel, x, y)


@inner
def _push_from(before, pos, vel, x, y, overlap):
    """The same by another person, and no farther than `_MAX_STEP_M` from where they were before this step."""
    _push(pos, vel, x, y, overlap)
    step_x, step_y = pos[0] - before[0], pos[1] - before[1]
    step_2 = step_x * step_x + step_y * step_y
    if step_2 > _MAX_STEP_M * _MAX_STEP_M:
        scale = _MAX_STEP_M / math.sqrt(step_2)
        pos[0], pos[1] = before[0] + scale * step_x, before[1] + scale * step_y


@inner
def _turn_aside(scene, i, scratch, x, y):
    """Turns the shoulders of person i towards lying across the normal (x, y): so they reach the least way along it."""
    heading, shoulder = scene.heading[i], scratch.shoulder[i]
    reach, ahead = shoulder[0] * x + shoulder[1] * y, math.cos(heading) * x + math.sin(heading) * y
    turn = math.atan2(abs(reach), abs(ahead) * (scene.radius[i] - half_depth(scene.radius[i])))
    turn = min(turn, _GIVE_RAD) * (1.0 if (reach > 0.0) == (ahead > 0.0) else -1.0)
    scene.heading[i] = heading + turn
    scratch.before[i, 2] = scene.heading[i]  # so turned they stay, if they find no room
    shoulder[0], shoulder[1] = shoulder_line(scene.heading[i], scene.radius[i])


@inner
def _body_gap(off_x, off_y, line_i, line_j, radius_i, radius_j):
    thickness = half_depth(radius_i) + half_depth(radius_j)
    return stadium_gap(off_x, off_y, line_i[0], line_i[1], line_j[0], line_j[1], thickness)


@inner
def part_bodies(scene, scratch, crush):
    """Moves overlapping people apart. Whether any overlapped.

    Half each, but who stands does not give way, nor does who is held by things (`keep_out_of_things`) to one who is
    free: two bodies would part by halves of halves, the held one pushed into the wall and back again. Where neither
    gives way, or in a `crush` (others push them together again), shoulders turn.
    """
    pos, radius, before, held = scene.pos, scene.radius, scratch.before, scratch.held
    for sweep in range(_SWEEPS):
        touched = False
        for i in range(len(pos)):
            if scene.behaviour[i] == ABSENT:
                continue
            i_stands = scene.behaviour[i] == STANDING
            reach = radius[i] + MAX_RADIUS_M + 2.0 * _MAX_STEP_M
            for n in range(collect(i, scratch.before[i, 0], scratch.before[i, 1], scratch, reach)):
                j = scratch.near[n]
                j_stands = scene.behaviour[j] == STANDING
                if j > i or (i_stands and j_stands):
                    continue
                off_x, off_y, touch = pos[i, 0] - pos[j, 0], pos[i, 1] - pos[j, 1], radius[i] + radius[j]
                if off_x * off_x + off_y * off_y >= touch * touch:
                    continue
                gap, x, y = _body_gap(off_x, off_y, scratch.shoulder[i], scratch.shoulder[j], radius[i], radius[j])
                if gap >= 0.0:
                    continue
                touched = True
                share = 0.5
                if i_stands or j_stands:
                    share = 0.0 if i_stands else 1.0
                elif held[i] != held[j]:
                    share = 0.0 if held[i] else 1.0
                if crush or ((held[i] or i_stands) and (held[j] or j_stands)):
                    _turn_aside(scene, i, scratch, x, y)
                    _turn_aside(scene, j, scratch, x, y)
                if share > 0.0:
                    _push_from(before[i], pos[i], scene.vel[i], x, y, -share * gap)
                if share < 1.0:
                    _push_from(before[j], pos[j], scene.vel[j], -x, -y, -(1.0 - share) * gap)
        if not touched:
            return sweep > 0
    return True


@inner
def _out_of_things(scene, i, scratch, standing, robot_reach):
    """Moves person i out of whatever they are in, one thing after another; how many there were.

    The first `standing` of `scratch.near` are people as good as things.
    """
    radius, count = scene.radius[i], 0
    pos, vel = scene.pos[i], scene.vel[i]
    if robot_reach > 0.0:
        off_x, off_y = pos[0] - scene.robot[0], pos[1] - scene.robot[1]
        distance = max(math.sqrt(off_x * off_x + off_y * off_y), 1e-6)
        if distance < radius + robot_reach:
            _push(pos, vel, off_x / distance, off_y / distance, radius + robot_reach - distance)
            count += 1
    for n in range(standing):
        j = scratch.near[n]
        off_x, off_y, reach = pos[0] - scene.pos[j, 0], pos[1] - scene.pos[j, 1], radius + scene.radius[j]
        if off_x * off_x + off_y * off_y >= reach * reach:
            continue
        gap, x, y = _body_gap(off_x, off_y, scratch.shoulder[i], scratch.shoulder[j], radius, scene.radius[j])
        if gap < -_TOUCH_M:
            _push(pos, vel, x, y, -gap)
            count += 1
    near = scratch.num_things[i]
    for n in range(near if near <= MAX_THINGS else len(scene.boxes) + len(scene.pillars)):
        k = scratch.things[i, n] if near <= MAX_THINGS else n
        distance, x, y = thing_offset(pos[0], pos[1], scene.boxes, scene.pillars, k)
        if distance < radius - _TOUCH_M:
            count += 1
            pos[0] += (radius - distance) * x
            pos[1] += (radius - distance) * y
            _stop_at(vel, x, y)
    return count


@inner
def keep_out_of_things(scene, i, scratch, robot_reach):
    """Keeps person i out of walls, furniture, pillars and people who stand, and off the robot.

    Where things leave no room, the person stays where they were, turned as they were. Notes whom things held.

    Args:
        robot_reach: distance from the robot's centre that is left free; 0 for one who does not notice it.
    """
    standing, x, y = 0, scratch.before[i, 0], scratch.before[i, 1]
    if scratch.grid[2] > 0:
        for n in range(collect(i, x, y, scratch, scene.radius[i] + MAX_RADIUS_M + _MAX_STEP_M)):
            if scene.behaviour[scratch.near[n]] == STANDING:
                scratch.near[standing] = scratch.near[n]
                standing += 1
    scratch.held[i] = False
    for _ in range(3):
        if _out_of_things(scene, i, scratch, standing, robot_reach) == 0:
            return
        scratch.held[i] = True
    scene.pos[i, 0], scene.pos[i, 1], scene.heading[i] = x, y, scratch.before[i, 2]
    scene.vel[i, 0] = scene.vel[i, 1] = 0.0
    scratch.shoulder[i, 0], scratch.shoulder[i, 1] = shoulder_line(scene.heading[i], scene.radius[i])
