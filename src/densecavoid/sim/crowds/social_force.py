"""Social force people (Helbing, Molnar, Phys. Rev. E 1995): pushed by others' elliptical potentials and by walls.

An alternative to the default for comparison with the field; its people are points that repel, so in dense crowds they
are slower and lie less close than real ones.
"""

from __future__ import annotations

import math

from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.crowds.neighbours import MAX_THINGS, collect, thing_offset, walks
from densecavoid.sim.people import YIELD

_RELAXATION_S = 0.5  # tau
_POTENTIAL = 2.1  # V0, m2/s2
_RANGE_M = 0.3  # sigma
_STEP_S = 2.0  # of the other person, which stretches the ellipse ahead of them
_WALL_POTENTIAL = 10.0  # U0, m2/s2
_WALL_RANGE_M = 0.2  # R
_HALF_VIEW_COSINE = -0.17364817766693033  # of half of 200 degrees
_UNSEEN = 0.5  # share of a force from behind
_OVERSPEED = 1.3
_SIGHT_M = 5.0


@kernel
def ellipse_force(off_x, off_y, step_x, step_y):
    """Acceleration on a person at `off` from another who moves by `step` (m) in the next stride.

    Minus the gradient of V0 exp(-b / sigma), 2 b = sqrt((|r| + |r - s|)^2 - |s|^2) (equations 3 and 4 there).
    """
    from_x, from_y = off_x - step_x, off_y - step_y
    near = max(math.sqrt(off_x * off_x + off_y * off_y), 1e-6)
    far = max(math.sqrt(from_x * from_x + from_y * from_y), 1e-6)
    minor = 0.5 * math.sqrt(max((near + far) * (near + far) - step_x * step_x - step_y * step_y, 1e-6))
    size = _POTENTIAL / _RANGE_M * math.exp(-minor / _RANGE_M) * (near + far) / (4.0 * minor)
    return size * (off_x / near + from_x / far), size * (off_y / near + from_y / far)


@inner
def choose_velocities(scene, scratch, dt):
    """Writes the velocities into `scratch.velocity` with which everybody goes on."""
    for i in range(len(scene.pos)):
        if not walks(scene.behaviour[i]):
            continue
        x, y, vx, vy = scene.pos[i, 0], scene.pos[i, 1], scene.vel[i, 0], scene.vel[i, 1]
        wish_x, wish_y = scratch.intended[i, 0], scratch.intended[i, 1]
        wish = math.sqrt(wish_x * wish_x + wish_y * wish_y)
        acc_x, acc_y = (wish_x - vx) / _RELAXATION_S, (wish_y - vy) / _RELAXATION_S
        near = collect(i, x, y, scratch, _SIGHT_M)
        for n in range(near + 1):
            if n < near:
                j = scratch.near[n]
                off_x, off_y = x - scene.pos[j, 0], y - scene.pos[j, 1]
                fx, fy = ellipse_force(off_x, off_y, _STEP_S * scene.vel[j, 0], _STEP_S * scene.vel[j, 1])
            elif scene.attitude[i] >= YIELD:
                off_x, off_y = x - scene.robot[0], y - scene.robot[1]
                fx, fy = ellipse_force(off_x, off_y, _STEP_S * scene.robot[2], _STEP_S * scene.robot[3])
            else:
                break
            ahead = -(fx * wish_x + fy * wish_y)
            seen = 1.0 if ahead >= _HALF_VIEW_COSINE * wish * math.sqrt(fx * fx + fy * fy) else _UNSEEN
            acc_x, acc_y = acc_x + seen * fx, acc_y + seen * fy
        for n in range(min(scratch.num_things[i], MAX_THINGS)):
            distance, normal_x, normal_y = thing_offset(x, y, scene.boxes, scene.pillars, scratch.things[i, n])
            size = _WALL_POTENTIAL / _WALL_RANGE_M * math.exp(-max(distance, 0.0) / _WALL_RANGE_M)
            acc_x, acc_y = acc_x + size * normal_x, acc_y + size * normal_y
        vx, vy = vx + acc_x * dt, vy + acc_y * dt
        speed, limit = math.sqrt(vx * vx + vy * vy), _OVERSPEED * scene.preferred_speed[i]
        scale = limit / speed if speed > limit else 1.0
        scratch.velocity[i, 0], scratch.velocity[i, 1] = vx * scale, vy * scale
