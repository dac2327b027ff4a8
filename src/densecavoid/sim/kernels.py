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
    CYL_Z_MIN,
    disc_offset,
    rectangle_offset,
)
from densecavoid.sim.lidar import scan
from densecavoid.sim.mesh_contact import FORCE_REACH_M, nearest_mesh, part_people_from_meshes
from densecavoid.sim.mesh_rays import mesh_depth, mesh_scan
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
def nearest_surfaces(state, b, x, y, top, meshes):
    """Distances from a point to the nearest surface that begins below `top`, and to the nearest person's.

    `meshes` is a `MeshSet`, or None where no world has one: numba then leaves out all that is for meshes.

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
    if meshes is not None:
        places = state.meshes[b, : state.num_meshes[b]]
        nearest, _, _ = nearest_mesh(x, y, top, nearest, places, meshes)
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
def _move_crowd(state, b, recordings, meshes, sub_step, replay_reactive, robot_radius, dt):
    intended = np.zeros((state.pos.shape[1], 2))
    if state.recording[b] >= 0:
        follow_recording(state, b, recordings, sub_step, replay_reactive[b], intended, dt)
        if not replay_reactive[b]:
            return
    else:
        intend_scripted(state, b, intended, dt)
    if meshes is not None:
        part_people_from_meshes(state, b, meshes, intended, FORCE_REACH_M)
    move_people(state, b, intended, robot_radius, dt)
    if meshes is not None:
        part_people_from_meshes(state, b, meshes, intended, 0.0)


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
    meshes,
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
            _move_crowd(state, b, recordings, meshes, tick, replay_reactive, robot_radius, dt)
            if dynamic:
                velocity[0] = limit_change(velocity[0], linear, max_linear_acc * dt)
                velocity[1] = limit_change(velocity[1], angular, max_angular_acc * dt)
            else:
                velocity[0], velocity[1] = linear, angular
            drive(pose, velocity[0], velocity[1], dt)
            if state.trigger_distance[b] < np.inf and np.isnan(state.spawn_time[b]):
                _appear(state, b, tick * dt)
            place_bodies(state, b)
            nearest, nearest_person, slot = nearest_surfaces(state, b, pose[0], pose[1], robot_height, meshes)
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
def begin(first, last, state, recordings, meshes, replay_reactive, which, robot_height, dt):
    """Brings worlds that were just filled to their first instant: recorded people in place, bodies, clearances."""
    for b in range(first, last):
        if not which[b]:
            continue
        if state.recording[b] >= 0:
            intended = np.zeros((state.pos.shape[1], 2))
            follow_recording(state, b, recordings, 0, replay_reactive[b], intended, dt)
        place_bodies(state, b)
        x, y = state.robot_pose[b, 0], state.robot_pose[b, 1]
        state.clearance_m[b], state.clearance_people_m[b], _ = nearest_surfaces(state, b, x, y, robot_height, meshes)


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


@kernel
def sense_meshes(first, last, pose, all_places, num_places, which, scans, images, lidar, camera, meshes):
    """Adds meshes to what `sense` measured with an upper limit but no lower one, and applies the lower one."""
    no_hits, no_pixels, no_starts = np.empty(0, np.int32), np.empty((0, 0), np.int32), np.empty(0, np.float32)
    level = np.zeros(lidar.ray_x.shape[0], np.float32)
    for b in range(first, last):
        if not which[b]:
            continue
        x, y, yaw = pose[b]
        cos, sin = math.cos(yaw), math.sin(yaw)
        places = all_places[b, : num_places[b]]
        ranges, image = scans[b], images[b]
        if places.shape[0] > 0:
            for row in image:
                for c in range(row.shape[0]):
                    row[c] = np.float32(np.inf) if np.isnan(row[c]) else row[c]
            lidar_x, lidar_y = x + cos * lidar.ahead, y + sin * lidar.ahead
            mesh_scan(
                ranges, no_hits, 0, lidar_x, lidar_y, lidar.height, yaw, lidar.ray_x, lidar.ray_y, level,
                no_starts, no_starts, float(lidar.max_range), places, meshes,
            )  # fmt: skip
            camera_x, camera_y = x + cos * camera.ahead, y + sin * camera.ahead
            mesh_depth(
                image, no_pixels, 0, camera_x, camera_y, camera.height, yaw, camera.column_slope, camera.row_slope,
                camera.pitch, float(camera.max_range), places, meshes,
            )  # fmt: skip
            for r in range(ranges.shape[0]):
                ranges[r] = ranges[r] if ranges[r] <= lidar.max_range else np.float32(np.inf)
        for row in image:
            for c in range(row.shape[0]):
                row[c] = row[c] if (row[c] >= camera.min_range) & (row[c] <= camera.max_range) else np.float32(np.nan)
