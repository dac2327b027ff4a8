"""The loops over worlds: one control step, and one look through the sensors. All maths is in the neighbouring files."""

from __future__ import annotations

import math

import numpy as np

from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.crowds import anticipation, orca, social_force
from densecavoid.sim.crowds.attitudes import step_in_the_way
from densecavoid.sim.crowds.groups import walk_together
from densecavoid.sim.crowds.neighbours import find_things, look_up, make_scratch, scene_of
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
    CYL_Z_MIN,
    disc_offset,
    rectangle_offset,
)
from densecavoid.sim.lidar import scan
from densecavoid.sim.people import ABSENT, PARTS, STANDING, place_body, remove_body
from densecavoid.sim.robot import drive, limit_change

_FAULT_SPEED = 0.1  # m/s towards the person in the last .5 s (BENCHMARK, Real crowds)


@inner
def place_bodies(state, b):
    """Puts the cylinders of everybody in world b where they are now."""
    for i in range(state.pos.shape[1]):
        parts = state.cylinders[b, PARTS * i : PARTS * (i + 1)]
        if state.behaviour[b, i] == ABSENT:
            remove_body(parts)
            continue
        vx, vy = state.vel[b, i, 0], state.vel[b, i, 1]
        place_body(
            parts,
            state.pos[b, i, 0],
            state.pos[b, i, 1],
            state.heading[b, i],
            math.sqrt(vx * vx + vy * vy),
            state.phase[b, i],
            state.radius[b, i],
            state.height[b, i],
        )


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
    ahead = 0.0
    for i in range(state.pos.shape[1]):
        if state.person_id[b, i] >= 0:
            reach = state.appear_distance[b] + state.radius[b, i]
            aside = state.pos[b, i, 1] - y
            if abs(aside) < reach:
                ahead = max(ahead, math.sqrt(reach * reach - aside * aside))
    for i in range(state.pos.shape[1]):
        if state.person_id[b, i] >= 0:
            state.pos[b, i, 0] = x + ahead
            state.behaviour[b, i] = STANDING
            state.heading[b, i] = math.pi
    state.spawn_time[b], state.spawn_line_x[b] = time_s, x + ahead


@inner
def _intend(state, b, recordings, sub_step, replay_reactive, scratch, robot_radius, dt):
    """Writes where everybody in world b wants to go; False where people move on rails."""
    scratch.intended[:] = 0.0
    if state.recording[b] >= 0:
        follow_recording(state, b, recordings, sub_step, replay_reactive[b], scratch.intended, dt)
        if not replay_reactive[b]:
            return False
    else:
        intend_scripted(state, b, scratch.intended, robot_radius, dt)
    walk_together(state, b, scratch)
    step_in_the_way(state, b, scratch.intended, robot_radius, dt)
    return True


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


@inner
def _begin_step(state, b, command, dynamic):
    """The command that world b carries out in this control step: linear, angular."""
    state.clearance_m[b], state.clearance_people_m[b] = np.inf, np.inf
    linear, angular = command[b]
    if dynamic:
        linear, angular = state.pending_command[b]
        state.pending_command[b] = command[b]
    return linear, angular


@inner
def _move_robot(state, b, linear, angular, robot, tick, dt):
    """One physics step of the robot among people who have just moved; whether the episode has come to its end."""
    pose, velocity = state.robot_pose[b], state.robot_velocity[b]
    if robot.dynamic:
        velocity[0] = limit_change(velocity[0], linear, robot.max_linear_acc * dt)
        velocity[1] = limit_change(velocity[1], angular, robot.max_angular_acc * dt)
    else:
        velocity[0], velocity[1] = linear, angular
    drive(pose, velocity[0], velocity[1], dt)
    if state.trigger_distance[b] < np.inf and np.isnan(state.spawn_time[b]):
        _appear(state, b, tick * dt)
    place_bodies(state, b)
    nearest, nearest_person, slot = nearest_surfaces(state, b, pose[0], pose[1], robot.height)
    state.clearance_m[b] = min(state.clearance_m[b], nearest)
    state.clearance_people_m[b] = min(state.clearance_people_m[b], nearest_person)
    if nearest < state.collision_distance_m[b]:
        state.collided[b] = True
        state.collided_person[b] = slot if nearest_person < state.collision_distance_m[b] else -1
        return True
    off_x, off_y = state.goal[b, 0] - pose[0], state.goal[b, 1] - pose[1]
    return off_x * off_x + off_y * off_y < state.goal_distance_m[b] ** 2


@inner
def _end_step(state, b):
    """Remembers which way the robot moved, and says whose fault a collision was."""
    trail, yaw = state.trail[b], state.robot_pose[b, 2]
    for k in range(trail.shape[0] - 1):
        trail[k] = trail[k + 1]
    trail[-1, 0], trail[-1, 1], trail[-1, 2] = math.cos(yaw), math.sin(yaw), state.robot_velocity[b, 0]
    if state.collided_person[b] >= 0:
        state.fault[b] = _at_fault(state, b, state.collided_person[b])
    state.step_count[b] += 1


@kernel
def advance(first, last, state, recordings, replay_reactive, command, robot, sub_steps, dt):
    """One control step of `sub_steps` x `dt` s for worlds first to last - 1; ends early at a collision or the goal.

    One kernel for each motion model, so that only those that are used are compiled.
    """
    scratch = make_scratch(state.pos.shape[1])
    for b in range(first, last):
        linear, angular = _begin_step(state, b, command, robot.dynamic)
        for tick in range(state.step_count[b] * sub_steps + 1, (state.step_count[b] + 1) * sub_steps + 1):
            if _intend(state, b, recordings, tick, replay_reactive, scratch, robot.radius, dt):
                scene = scene_of(state, b, robot.radius)
                look_up(scene, scratch)
                find_things(scene, scratch)
                anticipation.choose_velocities(scene, scratch, dt)
                move_people(scene, state.phase[b], scratch, dt)
            if _move_robot(state, b, linear, angular, robot, tick, dt):
                break
        _end_step(state, b)


@kernel
def advance_social_force(first, last, state, recordings, replay_reactive, command, robot, sub_steps, dt):
    """As `advance`, with the people of `crowds/social_force.py`."""
    scratch = make_scratch(state.pos.shape[1])
    for b in range(first, last):
        linear, angular = _begin_step(state, b, command, robot.dynamic)
        for tick in range(state.step_count[b] * sub_steps + 1, (state.step_count[b] + 1) * sub_steps + 1):
            if _intend(state, b, recordings, tick, replay_reactive, scratch, robot.radius, dt):
                scene = scene_of(state, b, robot.radius)
                look_up(scene, scratch)
                find_things(scene, scratch)
                social_force.choose_velocities(scene, scratch, dt)
                move_people(scene, state.phase[b], scratch, dt)
            if _move_robot(state, b, linear, angular, robot, tick, dt):
                break
        _end_step(state, b)


@kernel
def advance_orca(first, last, state, recordings, replay_reactive, command, robot, sub_steps, dt):
    """As `advance`, with the people of `crowds/orca.py`."""
    scratch = make_scratch(state.pos.shape[1])
    for b in range(first, last):
        linear, angular = _begin_step(state, b, command, robot.dynamic)
        for tick in range(state.step_count[b] * sub_steps + 1, (state.step_count[b] + 1) * sub_steps + 1):
            if _intend(state, b, recordings, tick, replay_reactive, scratch, robot.radius, dt):
                scene = scene_of(state, b, robot.radius)
                look_up(scene, scratch)
                find_things(scene, scratch)
                orca.choose_velocities(scene, scratch, dt)
                move_people(scene, state.phase[b], scratch, dt)
            if _move_robot(state, b, linear, angular, robot, tick, dt):
                break
        _end_step(state, b)


@kernel
def begin(first, last, state, recordings, replay_reactive, which, robot_height, dt):
    """Brings worlds that were just filled to their first instant: recorded people in place, bodies, clearances."""
    for b in range(first, last):
        if not which[b]:
            continue
        if state.recording[b] >= 0:
            intended = np.zeros((state.pos.shape[1], 2))
            follow_recording(state, b, recordings, state.step_count[b], replay_reactive[b], intended, dt)
        place_bodies(state, b)
        x, y = state.robot_pose[b, 0], state.robot_pose[b, 1]
        state.clearance_m[b], state.clearance_people_m[b], _ = nearest_surfaces(state, b, x, y, robot_height)


@kernel
def sense(first, last, state, which, scans, images, lidar, camera):
    """Lidar scans [B, rays] and depth images [B, height, width] of the worlds marked in `which`."""
    columns = np.empty((camera.column_slope.shape[0], camera.row_slope.shape[0]), np.float32)
    for b in range(first, last):
        if not which[b]:
            continue
        x, y, yaw = state.robot_pose[b]
        cos, sin = math.cos(yaw), math.sin(yaw)
        boxes = state.boxes[b, : state.num_boxes[b]]
        cylinders = state.cylinders[b, : state.num_cylinders[b]]
        lidar_x, lidar_y = x + cos * lidar.ahead, y + sin * lidar.ahead
        scan(scans[b], lidar, lidar_x, lidar_y, yaw, boxes, cylinders)
        camera_x, camera_y = x + cos * camera.ahead, y + sin * camera.ahead
        if camera.pitch == 0.0:
            render_level_depth(
                images[b], columns, camera, camera_x, camera_y, yaw, state.ceiling_m[b], boxes, cylinders
            )
        else:
            render_depth(images[b], camera, camera_x, camera_y, yaw, state.ceiling_m[b], boxes, cylinders)
