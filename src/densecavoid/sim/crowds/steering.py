"""What all motion models share: the step that a person makes with the velocity a model chose, and how they turn."""

from __future__ import annotations

import math

from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.crowds.contact import ROBOT_GAP_M, keep_out_of_things, part_bodies
from densecavoid.sim.crowds.neighbours import shoulder_line, walks
from densecavoid.sim.people import YIELD, advance_gait

_ROUNDS = 8  # of parting people and keeping them out of things, in a dense crowd
_TURN_S = 0.2  # in which a walking person turns most of the way to where they go
_MAX_TURN_RATE = 4.0  # rad/s
_TURN_SPEED = 0.5  # m/s: who is slower turns more slowly, and shuffles without turning


@inner
def move_people(scene, phase, scratch, dt):
    """Moves everybody for `dt` seconds with the velocities in `scratch`; bodies part, and stay out of things."""
    pos, vel = scene.pos, scene.vel
    for i in range(len(pos)):
        scratch.before[i, 0], scratch.before[i, 1], scratch.before[i, 2] = pos[i, 0], pos[i, 1], scene.heading[i]
        if walks(scene.behaviour[i]):
            for axis in range(2):
                vel[i, axis] = scratch.velocity[i, axis]
                pos[i, axis] += vel[i, axis] * dt
            # Turned before they part: shoulders that turn push others, too.
            scene.heading[i], phase[i] = walk(vel[i, 0], vel[i, 1], scene.heading[i], phase[i], scratch.turn[i], dt)
            scratch.shoulder[i, 0], scratch.shoulder[i, 1] = shoulder_line(scene.heading[i], scene.radius[i])
    scratch.held[:] = False
    for k in range(_ROUNDS):
        touched = part_bodies(scene, scratch, 2 * k >= _ROUNDS)
        for i in range(len(pos)):
            if walks(scene.behaviour[i]):
                robot_reach = scene.robot[4] + ROBOT_GAP_M if scene.attitude[i] >= YIELD else 0.0
                keep_out_of_things(scene, i, scratch, robot_reach)
        if not touched:
            break


@kernel
def walk(vx, vy, heading, phase, turn, dt):
    """Heading and phase of the stride of somebody who has walked for `dt` seconds: people turn the way they go."""
    speed = math.sqrt(vx * vx + vy * vy)
    if turn != 0.0 or speed > 0.1:
        share = 1.0 if turn != 0.0 else min(speed / _TURN_SPEED, 1.0)
        heading = turned(heading, math.atan2(vy, vx) + turn, share, dt)
    return heading, advance_gait(phase, speed, dt)


@kernel
def turned(heading, target, share, dt):
    """`heading` after turning towards `target` (rad) for `dt` seconds at a `share` of how fast people turn."""
    turn = (target - heading + math.pi) % (2.0 * math.pi) - math.pi
    step = turn * min(share * dt / _TURN_S, 1.0)
    most = _MAX_TURN_RATE * dt
    return heading + min(max(step, -most), most)
