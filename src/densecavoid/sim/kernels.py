"""The loops over worlds: one control step, and one look through the sensors. All maths is in the neighbouring files."""

from __future__ import annotations

import math

import numpy as np

from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.crowds import anticipation, orca, social_force
from densecavoid.sim.crowds.attitudes import step_in_the_way
from densecavoid.sim.crowds.groups import walk_together
from densecavoid.sim.crowds.neighbours import find_things, look_up, make_scratch, scene_of, see_robot
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
from densecavoid.sim.mesh_contact import FORCE_REACH_M, GROUND_M, nearest_mesh, part_people_from_meshes
from densecavoid.sim.mesh_rays import mesh_depth, mesh_scan
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


@inner
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
        nearest, _, _ = nearest_mesh(x, y, GROUND_M, top, nearest, places, meshes)
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
def _intend(state, b, recordings, meshes, sub_step, replay_reactive, scratch, robot_radius, dt):
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
    if meshes is not None:
        part_people_from_meshes(state, b, meshes, scratch.intended, FORCE_REACH_M)
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
def _begin(state, b, recordings, meshes, replay_reactive, scratch, robot, dt):
    """Brings world b, which was just filled, to its first instant: recorded people in place, bodies, clearances."""
    if state.recording[b] >= 0:
        follow_recording(state, b, recordings, 0 * state.step_count[b], replay_reactive[b], scratch.intended, dt)
    place_bodies(state, b)
    x, y = state.robot_pose[b, 0], state.robot_pose[b, 1]
    state.clearance_m[b], state.clearance_people_m[b], _ = nearest_surfaces(state, b, x, y, robot.height, meshes)


@inner
def _begin_step(state, b, command, dynamic):
    """The command that world b carries out in this control step: linear, angular."""
    state.clearance_m[b], state.clearance_people_m[b] = np.inf, np.inf
    linear, angular = command[b, 0], command[b, 1]
    if not dynamic:
        return linear, angular
    before = state.pending_command[b, 0], state.pending_command[b, 1]
    state.pending_command[b, 0], state.pending_command[b, 1] = linear, angular
    return before


@inner
def _move_robot(state, b, linear, angular, robot, meshes, tick, dt):
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
    nearest, nearest_person, slot = nearest_surfaces(state, b, pose[0], pose[1], robot.height, meshes)
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
        for part in range(3):
            trail[k, part] = trail[k + 1, part]
    trail[-1, 0], trail[-1, 1], trail[-1, 2] = math.cos(yaw), math.sin(yaw), state.robot_velocity[b, 0]
    if state.collided_person[b] >= 0:
        state.fault[b] = _at_fault(state, b, state.collided_person[b])
    state.step_count[b] += 1


@kernel
def advance(
    first,
    last,
    state,
    which,
    recordings,
    meshes,
    replay_reactive,
    by_forces,
    by_half_planes,
    command,
    robot,
    sub_steps,
    dt,
):
    """One control step of `sub_steps` x `dt` s for the marked worlds; ends early at a collision or the goal.

    Without any `sub_steps` worlds that were just filled are brought to their first instant: the same kernel, because a
    second one would have to be compiled too.

    Args:
        by_forces: None, or True for the people of `crowds/social_force.py`; `by_half_planes` alike for those of
            `crowds/orca.py`. What is None, numba leaves out: only the motion model that is used is compiled.
    """
    scratch = make_scratch(state.pos.shape[1])
    for b in range(first, last):
        if not which[b]:
            continue
        if sub_steps == 0:
            _begin(state, b, recordings, meshes, replay_reactive, scratch, robot, dt)
            continue
        linear, angular = _begin_step(state, b, command, robot.dynamic)
        scene = scene_of(state, b, scratch)
        first_tick = state.step_count[b] * sub_steps + 1
        for tick in range(first_tick, first_tick + sub_steps):
            if _intend(state, b, recordings, meshes, tick, replay_reactive, scratch, robot.radius, dt):
                see_robot(state, b, scratch, robot.radius)
                look_up(scene, scratch)
                find_things(scene, scratch, tick == first_tick)
                if by_forces is not None:
                    social_force.choose_velocities(scene, scratch, dt)
                elif by_half_planes is not None:
                    orca.choose_velocities(scene, scratch, dt)
                else:
                    anticipation.choose_velocities(scene, scratch, dt)
                move_people(scene, state.phase[b], scratch, dt)
                if meshes is not None:
                    part_people_from_meshes(state, b, meshes, scratch.intended, 0.0)
            if _move_robot(state, b, linear, angular, robot, meshes, tick, dt):
                break
        _end_step(state, b)


@kernel
def surfaces_at(state, b, points, top, meshes, distances):
    """Distances from points [N, 2] to the nearest surface in world b that begins below `top`, into `distances` [N]."""
    for n in range(points.shape[0]):
        distances[n], _, _ = nearest_surfaces(state, b, points[n, 0], points[n, 1], top, meshes)


@inner
def _mounted(state, b, ahead):
    """Where what is mounted `ahead` of the centre of the robot in world b is, and its yaw."""
    x, y, yaw = state.robot_pose[b]
    return x + math.cos(yaw) * ahead, y + math.sin(yaw) * ahead, yaw


@inner
def _scan_world(state, b, ranges, hits, ray_x, ray_y, lidar):
    pose = _mounted(state, b, lidar.ahead)
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
        camera_x, camera_y, yaw = _mounted(state, b, camera.ahead)
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
    camera_x, camera_y, yaw = _mounted(state, b, camera.ahead)
    boxes = state.boxes[b, : state.num_boxes[b] - state.num_glass[b]]
    cylinders = state.cylinders[b, : state.num_cylinders[b]]
    first_box, ceiling = state.cylinders.shape[1], state.ceiling_m[b]
    render_depth(image, hits, camera, camera_x, camera_y, yaw, ceiling, boxes, cylinders, first_box)


@kernel
def sense_meshes(first, last, state, which, scans, images, scan_hits, image_hits, lidar, camera, meshes):
    """Adds what `meshes` (a `MeshSet`) the rays of `sense_hits` meet before all else."""
    ray_x, ray_y = lidar.ray_x.copy(), lidar.ray_y.copy()
    start_x, start_y = np.zeros(ray_x.shape[0], np.float32), np.zeros(ray_x.shape[0], np.float32)
    for b in range(first, last):
        if not which[b] or state.num_meshes[b] == 0:
            continue
        x, y, yaw = _mounted(state, b, lidar.ahead)
        if lidar.start < 0.0:
            linear, angular = state.robot_velocity[b]
            turn_rays(lidar, angular, ray_x, ray_y)
            for r in range(ray_x.shape[0]):
                time = lidar.start + lidar.interval * r
                start_x[r], start_y[r] = linear * time, angular * lidar.ahead * time
        number = state.cylinders.shape[1] + state.boxes.shape[1]
        places = state.meshes[b, : state.num_meshes[b]]
        rays, reach = (ray_x, ray_y, lidar.ray_z, start_x, start_y), float(lidar.max_range)
        mesh_scan(scans[b], scan_hits[b], number, x, y, lidar.height, yaw, *rays, reach, places, meshes)
        picture_meshes(state, b, images[b], image_hits[b], camera, meshes)


@inner
def picture_meshes(state, b, image, hits, camera, meshes):
    """The same for a `picture`."""
    x, y, yaw = _mounted(state, b, camera.ahead)
    number = state.cylinders.shape[1] + state.boxes.shape[1]
    places = state.meshes[b, : state.num_meshes[b]]
    optics = (camera.column_slope, camera.row_slope, camera.pitch, float(camera.max_range))
    mesh_depth(image, hits, number, x, y, camera.height, yaw, *optics, places, meshes)


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
