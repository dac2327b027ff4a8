"""The default people: they anticipate collisions, and walk no faster than the free space ahead of them allows.

Where to: the power law of anticipation, E(tau) = k tau^-2 exp(-tau/tau0) (Karamouzas, Skinner, Guy, Phys. Rev. Lett.
2014), a force along the offset that two bodies will have when they touch. How fast: collision-free speed,
v <= (s - l) / T, with s - l the free space to the next body in that direction (Tordeux, Chraibi, Seyfried 2016). Who is
held up looks to both sides for a way on and takes the one that leads farthest (Moussaid, Helbing, Theraulaz 2011).
"""

from __future__ import annotations

import math

from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.crowds.neighbours import MAX_THINGS, collect, thing_offset, walks
from densecavoid.sim.people import YIELD, half_depth

_RELAXATION_S = 0.4  # to the intended velocity (Helbing-Molnar's tau is .5)
_ANTICIPATION_GAIN = 1.5  # k of the power law
_ANTICIPATION_HORIZON_S = 3.0  # tau0 of the power law
_HORIZON_S = 8.0  # collisions later than this are not thought of
_SIGHT_M = 5.0
_ELBOW_ROOM_M = 0.05  # people keep this between bodies when they can
_ROBOT_ROOM_M = 0.15  # and this to a robot that they notice
_MAX_ACCELERATION = 4.0  # m/s2
_WALL_FORCE = 3.0  # m/s2 at the surface
_WALL_RANGE_M = 0.15
_OVERSPEED = 1.3  # the greatest speed as a multiple of the preferred one

# Chosen so that corridor flow is that of the HERMES recordings (benchmarks/crowds.py).
_HEADWAY_S = 0.53  # T: time in which a person would walk the free space ahead
_GAP_M = 0.23  # that people leave to the body ahead even when they stand
_BRAKING_S = 0.12  # in which people adapt to less free space
_SWATH = 0.7  # of both widths: bodies that overlap less do not hold each other up
_SEEN_BEHIND = -0.16  # cosine: people see 160 degrees around where they want to go
_ASIDE = 0.7  # share of the force, of which only the part across the wished direction acts
_FOLLOW_S = 1.0  # how far ahead people think when they choose a way
_CONTENT = 0.8  # of the way they would like to go in that time: with less, people look for another
_WORTH_TURNING = 0.03  # of it: so much longer another way must be
_LOOK_RAD = (0.12, 0.3, 0.6, 1.0, 1.5)  # to both sides
_SHOULDER_TURN = 1.4  # rad by which people turn a shoulder to squeeze past one who faces them
_SQUEEZE_M = 1.2  # when that one is nearer than this
_BESIDE_M = 0.5  # and no farther aside
_CREEP = 0.5  # m/s with which they then press on


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
def _look_around(scene, i, scratch):
    """Notes in `scratch.seen` the bodies that person i sees ahead or beside them.

    Returns:
        (how many bodies, acceleration x, y) from anticipating them.
    """
    x, y = scene.pos[i, 0], scene.pos[i, 1]
    vx, vy = scene.vel[i, 0], scene.vel[i, 1]
    wish_x, wish_y = scratch.intended[i, 0], scratch.intended[i, 1]
    wish = math.sqrt(wish_x * wish_x + wish_y * wish_y)
    own_x, own_y = scratch.shoulder[i]
    own_depth = half_depth(scene.radius[i])
    total_x, total_y, count = 0.0, 0.0, 0
    near = collect(i, x, y, scratch, _SIGHT_M)
    for n in range(near + 1):
        if n < near:
            j = scratch.near[n]
            off_x, off_y = scene.pos[j, 0] - x, scene.pos[j, 1] - y
        else:
            if scene.attitude[i] < YIELD:
                break
            j = -1
            off_x, off_y = scene.robot[0] - x, scene.robot[1] - y
        distance = math.sqrt(off_x * off_x + off_y * off_y)
        if off_x * wish_x + off_y * wish_y < -_SEEN_BEHIND * distance * wish:
            continue
        if j >= 0:
            line_x, line_y = scratch.shoulder[j]
            depth, room = half_depth(scene.radius[j]), _ELBOW_ROOM_M
            other_vx, other_vy = scene.vel[j, 0], scene.vel[j, 1]
            way_x, way_y = scratch.intended[j] if walks(scene.behaviour[j]) else scene.vel[j]
        else:
            line_x, line_y, depth, room = 0.0, 0.0, scene.robot[4], _ROBOT_ROOM_M
            other_vx, other_vy, way_x, way_y = scene.robot[2], scene.robot[3], scene.robot[2], scene.robot[3]
        width = abs(own_x * off_x + own_y * off_y) + abs(line_x * off_x + line_y * off_y)
        reach = own_depth + depth + room + width / max(distance, 1e-6)
        fx, fy = anticipation_force(off_x, off_y, vx - other_vx, vy - other_vy, reach)
        total_x += fx
        total_y += fy
        beside = abs(off_x * wish_y - off_y * wish_x)
        if way_x * wish_x + way_y * wish_y < 0.0 and distance < _SQUEEZE_M and beside < _BESIDE_M * wish:
            scratch.turn[i] = _SHOULDER_TURN  # two who both do so have room in half the width
        row = scratch.seen[count]
        row[0], row[1], row[2], row[3] = off_x, off_y, way_x, way_y
        row[4], row[5], row[6] = depth, line_x, line_y
        count += 1
    return count, total_x, total_y


@inner
def _wall_force(x, y, radius, scene, things, near, walls):
    """Notes in `walls` the things around a person; the acceleration away from them."""
    total_x, total_y = 0.0, 0.0
    for n in range(near):
        distance, normal_x, normal_y = thing_offset(x, y, scene.boxes, scene.pillars, things[n])
        gap = distance - radius
        size = _WALL_FORCE * math.exp(-max(gap, 0.0) / _WALL_RANGE_M) if gap < 0.6 else 0.0
        total_x += size * normal_x
        total_y += size * normal_y
        walls[n, 0], walls[n, 1], walls[n, 2] = gap, normal_x, normal_y
    return total_x, total_y


@inner
def _free_space(seen, bodies, walls, num_walls, depth, line_x, line_y, dir_x, dir_y, speed):
    """What lies in a direction: metres to the first body or thing as they are now, and metres that a person can go at
    a speed before they meet one, if the others go where they want to."""
    free, way = _SIGHT_M, _SIGHT_M
    for n in range(bodies):
        row = seen[n]
        along, across = row[0] * dir_x + row[1] * dir_y, row[1] * dir_x - row[0] * dir_y
        width = depth + row[4] + abs(line_y * dir_x - line_x * dir_y) + abs(row[6] * dir_x - row[5] * dir_y)
        approach, drift = speed - row[2] * dir_x - row[3] * dir_y, row[2] * dir_y - row[3] * dir_x
        closing, speed_2 = along * approach + across * drift, max(approach * approach + drift * drift, 1e-6)
        miss_2 = along * along + across * across - closing * closing / speed_2
        reach = _SWATH * width
        oncoming = row[2] * dir_x + row[3] * dir_y < -0.1
        if along > 0.0 and abs(across) < reach and not (oncoming and miss_2 > reach * reach):
            inside = 1.0 - across * across / (reach * reach)
            body = depth + row[4]  # whoever has turned a shoulder turns back to follow
            free = min(free, (along - body * math.sqrt(inside)) / inside - (0.0 if oncoming else _GAP_M))
        if closing > 0.0 and miss_2 < reach * reach:
            way = min(way, speed * (closing / speed_2 - math.sqrt((reach * reach - miss_2) / speed_2)))
    for n in range(num_walls):
        towards = -(walls[n, 1] * dir_x + walls[n, 2] * dir_y)
        if towards > 0.05 and walls[n, 0] < free * towards:
            free = walls[n, 0] / towards
            way = min(way, free)
    return max(free, 0.0), max(way, 0.0)


@inner
def choose_velocities(scene, scratch, dt):
    """Writes the velocities into `scratch.velocity` with which everybody goes on."""
    walls = scratch.walls
    for i in range(len(scene.pos)):
        if not walks(scene.behaviour[i]):
            continue
        radius = scene.radius[i]
        depth = half_depth(radius)
        line_x, line_y = scratch.shoulder[i]
        scratch.turn[i] = 0.0
        x, y, vx, vy = scene.pos[i, 0], scene.pos[i, 1], scene.vel[i, 0], scene.vel[i, 1]
        wish_x, wish_y = scratch.intended[i, 0], scratch.intended[i, 1]
        bodies, force_x, force_y = _look_around(scene, i, scratch)
        things = min(scratch.num_things[i], MAX_THINGS)
        wall_x, wall_y = _wall_force(x, y, radius, scene, scratch.things[i], things, walls)
        force_x, force_y = _ASIDE * force_x + wall_x, _ASIDE * force_y + wall_y
        wish_2 = wish_x * wish_x + wish_y * wish_y
        if wish_2 > 1e-6:  # forces turn people aside; how fast they walk is for the space ahead to say
            along = (force_x * wish_x + force_y * wish_y) / wish_2
            force_x, force_y = force_x - along * wish_x, force_y - along * wish_y
        to_x, to_y = wish_x + _RELAXATION_S * force_x, wish_y + _RELAXATION_S * force_y
        speed = math.sqrt(to_x * to_x + to_y * to_y)
        if speed > 1e-6:
            to_x, to_y = to_x / speed, to_y / speed
            speed = min(speed, math.sqrt(wish_2) if wish_2 > 1e-6 else scene.preferred_speed[i])
            speed = min(speed, _OVERSPEED * scene.preferred_speed[i])
            dir_x, dir_y, enough, best, ahead = to_x, to_y, speed * _FOLLOW_S, -1.0, 0.0
            for k in range(-1, 2 * len(_LOOK_RAD)):
                if k == 0 and best >= _CONTENT * enough:
                    break
                angle = _LOOK_RAD[k // 2] * (2.0 * (k % 2) - 1.0) if k >= 0 else 0.0  # to the right first
                cos, sin = math.cos(angle), math.sin(angle)
                look_x, look_y = cos * dir_x - sin * dir_y, sin * dir_x + cos * dir_y
                free, worth = _free_space(
                    scratch.seen, bodies, walls, things, depth, line_x, line_y, look_x, look_y, speed
                )
                worth = min(worth, enough)
                if k >= 0:
                    worth *= cos
                if worth > best + _WORTH_TURNING * enough or k < 0:
                    best, ahead, to_x, to_y = worth, free / _HEADWAY_S, look_x, look_y
            speed = min(speed, max(ahead, _CREEP) if scratch.turn[i] != 0.0 else ahead)
        share = min(dt / (_BRAKING_S if vx * vx + vy * vy > speed * speed else _RELAXATION_S), 1.0)
        scratch.velocity[i, 0] = vx + share * (speed * to_x - vx)
        scratch.velocity[i, 1] = vy + share * (speed * to_y - vy)
