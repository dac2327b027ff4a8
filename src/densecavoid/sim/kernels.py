"""The loops over worlds: one control step, and one look through the sensors. All maths is in the neighbouring files."""

from __future__ import annotations

import math

import numpy as np

from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.crowds.recorded import follow_recording
from densecavoid.sim.crowds.scripted import intend_scripted
from densecavoid.sim.crowds.steering import move_people
from densecavoid.sim.depth import render_depth, render_level_depth
from densecavoid.sim.geometry import (
    BOX_HALF_LENGTH,
    BOX_HALF_WIDTH,
    BOX_X,
    BOX_Y,
    BOX_Z_MIN,
    CYL_RADIUS,
    CYL_X,
    CYL_Y,
    CYL_Z_MIN,
    disc_offset,
    rectangle_offset,
)
from densecavoid.sim.lidar import scan, turn_rays
from densecavoid.sim.people import ABSENT, PARTS, STANDING, place_body, remove_body
from densecavoid.sim.robot import drive, limit_change

_FAULT_SPEED = 0.1  # m/s towards the person in the last .5 s (BENCHMARK, Real crowds)


@inner
def _place(state, b, i):
    """Puts the cylinders of person i in world b where they are now."""
    vx, vy = state.vel[b, i, 0], state.vel[b, i, 1]
    place_body(
        state.cylinders[b, PARTS * i : PARTS * (i + 1)],
        state.pos[b, i, 0],
        state.pos[b, i, 1],
        state.heading[b, i],
        math.sqrt(vx * vx + vy * vy),
        state.phase[b, i],
        state.radius[b, i],
        state.height[b, i],
    )


@inner
def place_bodies(state, b):
    """Puts the cylinders of everybody in world b where they are now."""
    for i in range(state.pos.shape[1]):
        if state.behaviour[b, i] == ABSENT:
            remove_body(state.cylinders[b, PARTS * i : PARTS * (i + 1)])
        else:
            _place(state, b, i)


@kernel
def nearest_surfaces(state, b, x, y, top):
    """Distances from a point to the nearest surface that begins below `top`, and to the nearest person's.

    Returns:
        (distance to anything, distance to a person, that person's slot or -1); inf where there is none.
    """
    nearest, nearest_person, slot = np.inf, np.inf, -1
    people_parts = PARTS * state.pos.shape[1]
    for k in range(state.num_cylinders[b]):
        cylinder = state.cylinders[b, k]
        if cylinder[CYL_RADIUS] <= 0.0 or cylinder[CYL_Z_MIN] >= top:
            continue
        distance, _, _ = disc_offset(x, y, cylinder)
        nearest = min(nearest, distance)
        if k < people_parts and distance < nearest_person:
            nearest_person, slot = distance, k // PARTS
    for k in range(state.num_boxes[b]):
        box = state.boxes[b, k]
        reach = box[BOX_HALF_LENGTH] + box[BOX_HALF_WIDTH] + nearest
        if box[BOX_Z_MIN] >= top or abs(x - box[BOX_X]) > reach or abs(y - box[BOX_Y]) > reach:
            continue
        distance, _, _ = rectangle_offset(x, y, box)
        nearest = min(nearest, distance)
    return nearest, nearest_person, slot


@inner
def _appear(state, b, time_s):
    """Lets the waiting people of world b stand across the robot's way, once it has come far enough."""
    x, y = state.robot_pose[b, 0], state.robot_pose[b, 1]
    if math.hypot(x - state.start_pose[b, 0], y - state.start_pose[b, 1]) < state.trigger_distance[b]:
        return
    ahead = 0.0  # how far the line must be for nobody's surface to be nearer than asked for
    for i in range(state.pos.shape[1]):
        if state.person_id[b, i] < 0:
            continue
        state.behaviour[b, i], state.heading[b, i] = STANDING, math.pi
        state.pos[b, i, 0] = 0.0
        _place(state, b, i)
        for part in state.cylinders[b, PARTS * i : PARTS * (i + 1)]:
            reach, aside = state.appear_distance[b] + part[CYL_RADIUS], part[CYL_Y] - y
            if abs(aside) < reach:
                ahead = max(ahead, math.sqrt(reach * reach - aside * aside) - part[CYL_X])
    for i in range(state.pos.shape[1]):
        if state.person_id[b, i] >= 0:
            state.pos[b, i, 0] = x + ahead
    state.spawn_time[b], state.spawn_line_x[b] = time_s, x + ahead


@inner
def _move_crowd(state, b, scratch, recordings, sub_step, replay_reactive, robot_radius, dt):
    intended, new_vel = scratch[0], scratch[1]
    intended[:] = 0.0
    if state.recording[b] >= 0:
        follow_recording(state, b, recordings, sub_step, replay_reactive[b], intended, dt)
        if not replay_reactive[b]:
            return
    else:
        intend_scripted(state, b, intended, dt)
    move_people(state, b, intended, new_vel, robot_radius, dt)


@inner
def _at_fault(state, b, slot):
    """Whether the robot moved towards the person it hit in the last half second."""
    off_x = state.pos[b, slot, 0] - state.robot_pose[b, 0]
    off_y = state.pos[b, slot, 1] - state.robot_pose[b, 1]
    distance = max(math.hypot(off_x, off_y), 1e-6)
    for k in range(state.trail.shape[1]):
        cos, sin, speed = state.trail[b, k]
        if speed * (cos * off_x + sin * off_y) / distance > _FAULT_SPEED:
            return True
    return False


@kernel
def advance(
    first,
    last,
    state,
    recordings,
    replay_reactive,
    command,
    dynamic,
    max_linear_acc,
    max_angular_acc,
    robot_radius,
    robot_height,
    sub_steps,
    dt,
):
    """One control step of `sub_steps` x `dt` s for worlds first to last - 1; ends early at a collision or the goal."""
    scratch = np.empty((2, state.pos.shape[1], 2))
    for b in range(first, last):
        if dynamic:
            linear, angular = state.pending_command[b]
            state.pending_command[b] = command[b]
        else:
            linear, angular = command[b]
        state.clearance_m[b], state.clearance_people_m[b] = np.inf, np.inf
        pose, velocity = state.robot_pose[b], state.robot_velocity[b]
        trail = state.trail[b]
        nearest_person, slot = np.inf, -1
        for s in range(sub_steps):
            tick = state.step_count[b] * sub_steps + s + 1
            _move_crowd(state, b, scratch, recordings, tick, replay_reactive, robot_radius, dt)
            if dynamic:
                velocity[0] = limit_change(velocity[0], linear, max_linear_acc * dt)
                velocity[1] = limit_change(velocity[1], angular, max_angular_acc * dt)
            else:
                velocity[0], velocity[1] = linear, angular
            drive(pose, velocity[0], velocity[1], dt)
            if state.trigger_distance[b] < np.inf and np.isnan(state.spawn_time[b]):
                _appear(state, b, tick * dt)
            place_bodies(state, b)
            nearest, nearest_person, slot = nearest_surfaces(state, b, pose[0], pose[1], robot_height)
            state.clearance_m[b] = min(state.clearance_m[b], nearest)
            state.clearance_people_m[b] = min(state.clearance_people_m[b], nearest_person)
            if nearest < state.collision_distance_m[b]:
                state.collided[b] = True
                break
            off_x, off_y = state.goal[b, 0] - pose[0], state.goal[b, 1] - pose[1]
            if off_x * off_x + off_y * off_y < state.goal_distance_m[b] ** 2:
                break
        for k in range(trail.shape[0] - 1):
            trail[k] = trail[k + 1]
        trail[-1, 0], trail[-1, 1], trail[-1, 2] = math.cos(pose[2]), math.sin(pose[2]), velocity[0]
        if state.collided[b] and nearest_person < state.collision_distance_m[b]:
            state.collided_person[b] = slot
            state.fault[b] = _at_fault(state, b, slot)
        state.step_count[b] += 1


@kernel
def begin(first, last, state, recordings, replay_reactive, which, robot_height, dt):
    """Brings worlds that were just filled to their first instant: recorded people in place, bodies, clearances."""
    for b in range(first, last):
        if not which[b]:
            continue
        if state.recording[b] >= 0:
            intended = np.zeros((state.pos.shape[1], 2))
            follow_recording(state, b, recordings, 0, replay_reactive[b], intended, dt)
        place_bodies(state, b)
        x, y = state.robot_pose[b, 0], state.robot_pose[b, 1]
        state.clearance_m[b], state.clearance_people_m[b], _ = nearest_surfaces(state, b, x, y, robot_height)


@inner
def _scan_world(state, b, ranges, hits, ray_x, ray_y, lidar):
    x, y, yaw = state.robot_pose[b]
    pose = (x + math.cos(yaw) * lidar.ahead, y + math.sin(yaw) * lidar.ahead, yaw)
    motion = (state.robot_velocity[b, 0], state.robot_velocity[b, 1])
    boxes = state.boxes[b, : state.num_boxes[b] - state.num_glass[b]]
    cylinders = state.cylinders[b, : state.num_cylinders[b]]
    first_box = state.cylinders.shape[1]
    ceiling = state.ceiling_m[b]
    scan(ranges, hits, lidar, ray_x, ray_y, pose, motion, ceiling, boxes, cylinders, state.vel[b], first_box)


@kernel
def sense_level(first, last, state, which, scans, images, lidar, camera, scan_most, least, most):
    """What exact sensors with a level camera measure in the marked worlds: the fast way.

    Args:
        scans: [B, rays] gets ranges up to `scan_most`, inf beyond.
        images: [B, height, width] gets depths from `least` to `most`, NaN elsewhere.
    """
    columns = np.empty((camera.column_slope.shape[0], camera.row_slope.shape[0]), np.float32)
    hits = np.empty(scans.shape[1], np.int32)
    for b in range(first, last):
        if not which[b]:
            continue
        _scan_world(state, b, scans[b], hits, lidar.ray_x, lidar.ray_y, lidar)
        for r in range(scans.shape[1]):
            scans[b, r] = scans[b, r] if scans[b, r] <= scan_most else np.float32(np.inf)
        x, y, yaw = state.robot_pose[b]
        camera_x, camera_y = x + math.cos(yaw) * camera.ahead, y + math.sin(yaw) * camera.ahead
        boxes = state.boxes[b, : state.num_boxes[b] - state.num_glass[b]]
        cylinders = state.cylinders[b, : state.num_cylinders[b]]
        ceiling = state.ceiling_m[b]
        render_level_depth(images[b], columns, camera, camera_x, camera_y, yaw, ceiling, boxes, cylinders, least, most)


@kernel
def sense_hits(first, last, state, which, scans, images, scan_hits, image_hits, lidar, camera):
    """The same for any camera and for scanners that sweep, however far, with what each ray meets.

    Args:
        scan_hits: i32 [B, rays] gets numbers of solids (geometry.py).
        image_hits: i32 [B, height, width] alike.
    """
    ray_x, ray_y = lidar.ray_x.copy(), lidar.ray_y.copy()
    for b in range(first, last):
        if not which[b]:
            continue
        if lidar.start < 0.0:
            turn_rays(lidar, state.robot_velocity[b, 1], ray_x, ray_y)
        _scan_world(state, b, scans[b], scan_hits[b], ray_x, ray_y, lidar)
        picture(state, b, images[b], image_hits[b], camera)


@inner
def picture(state, b, image, hits, camera):
    """Depths, however far, of world b as the camera on its robot sees it, and what each pixel shows."""
    x, y, yaw = state.robot_pose[b]
    camera_x, camera_y = x + math.cos(yaw) * camera.ahead, y + math.sin(yaw) * camera.ahead
    boxes = state.boxes[b, : state.num_boxes[b] - state.num_glass[b]]
    cylinders = state.cylinders[b, : state.num_cylinders[b]]
    first_box, ceiling = state.cylinders.shape[1], state.ceiling_m[b]
    render_depth(image, hits, camera, camera_x, camera_y, yaw, ceiling, boxes, cylinders, first_box)


@kernel
def limit_ranges(first, last, which, scans, images, scan_most, least, most):
    """Leaves out what is out of range: inf in scans, NaN in images."""
    for b in range(first, last):
        if not which[b]:
            continue
        for r in range(scans.shape[1]):
            scans[b, r] = scans[b, r] if scans[b, r] <= scan_most else np.float32(np.inf)
        for v in range(images.shape[1]):
            for u in range(images.shape[2]):
                t = images[b, v, u]
                images[b, v, u] = t if (t >= least) & (t <= most) else np.float32(np.nan)
