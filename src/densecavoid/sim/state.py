"""The state of B worlds as a structure of arrays: what the kernels read and write, and nothing else."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from densecavoid.sim.people import PARTS
from densecavoid.sim.spec import NET_LINKS, NET_PLACES


class WorldState(NamedTuple):
    """Everything that changes between episodes and steps. First axis: world. World frame, metres, seconds, radians."""

    # the robot
    robot_pose: np.ndarray  # f64 [B, 3]
    robot_velocity: np.ndarray  # f64 [B, 2] linear, angular
    pending_command: np.ndarray  # f64 [B, 2] the command that `dynamic` carries out one step late
    start_pose: np.ndarray  # f64 [B, 3]
    goal: np.ndarray  # f64 [B, 2]
    trail: np.ndarray  # f64 [B, 5, 3] heading and linear velocity of the last .5 s: cos, sin, v
    # the episode
    step_count: np.ndarray  # i64 [B]
    time_limit_s: np.ndarray  # f64 [B]
    collision_distance_m: np.ndarray  # f64 [B]
    goal_distance_m: np.ndarray  # f64 [B]
    clearance_m: np.ndarray  # f64 [B] least in the last control step
    clearance_people_m: np.ndarray  # f64 [B]
    collided: np.ndarray  # bool [B]
    collided_person: np.ndarray  # i32 [B]
    fault: np.ndarray  # bool [B]
    waypoints: np.ndarray  # f64 [B, W, 2]
    num_waypoints: np.ndarray  # i64 [B]
    # what stands there
    boxes: np.ndarray  # f32 [B, NB, 8]
    num_boxes: np.ndarray  # i64 [B]
    cylinders: np.ndarray  # f32 [B, PARTS * P + NC, 5] people's parts first
    num_cylinders: np.ndarray  # i64 [B] people's parts included
    box_material: np.ndarray  # u8 [B, NB]
    num_glass: np.ndarray  # i64 [B] so many of the boxes, the last ones
    cylinder_material: np.ndarray  # u8 [B, NC] without people
    ceiling_m: np.ndarray  # f64 [B] inf outdoors
    meshes: np.ndarray  # f64 [B, M, 6] placed triangle meshes (mesh.PLACE_...)
    num_meshes: np.ndarray  # i64 [B]
    # people
    pos: np.ndarray  # f64 [B, P, 2]
    vel: np.ndarray  # f64 [B, P, 2]
    person_goal: np.ndarray  # f64 [B, P, 2]
    preferred_speed: np.ndarray  # f64 [B, P]
    radius: np.ndarray  # f64 [B, P]
    height: np.ndarray  # f64 [B, P]
    heading: np.ndarray  # f64 [B, P]
    phase: np.ndarray  # f64 [B, P] of the stride
    behaviour: np.ndarray  # i8 [B, P]
    person_id: np.ndarray  # i32 [B, P]
    group: np.ndarray  # i16 [B, P] who walks or stands together; -1: alone
    attitude: np.ndarray  # i8 [B, P] towards the robot: ignores it, yields, blocks its way
    curious_s: np.ndarray  # f64 [B, P] for how long one who blocks the robot's way will still do so
    entrance: np.ndarray  # f64 [B, P, 2] where a circulating person enters; NaN for others
    next_id: np.ndarray  # i32 [B] person_id of who enters next
    wander_area: np.ndarray  # f64 [B, 4]
    change_rate: np.ndarray  # f64 [B] changes of mind a second
    net_places: np.ndarray  # f32 [B, NET_PLACES, 3] x, y, spread
    net_links: np.ndarray  # i8 [B, NET_PLACES, NET_LINKS] -1: none
    leg: np.ndarray  # i8 [B, P, 2] place of the net come from, place gone to; -1: not on the net
    random: np.ndarray  # u64 [B] state of each world's own generator
    # people who appear suddenly
    trigger_distance: np.ndarray  # f64 [B] inf: nobody will
    appear_distance: np.ndarray  # f64 [B]
    spawn_time: np.ndarray  # f64 [B] NaN before
    spawn_line_x: np.ndarray  # f64 [B] NaN before
    # recorded people
    recording: np.ndarray  # i64 [B] index of the recording, -1: none
    recording_step: np.ndarray  # i64 [B] its time step at the start of the episode


def allocate(
    num_worlds: int,
    num_people: int,
    num_boxes: int,
    num_static_cylinders: int,
    num_waypoints: int,
    num_meshes: int = 0,
) -> WorldState:
    """Empty worlds with room for so much."""
    b, p = num_worlds, num_people

    def real(*shape: int) -> np.ndarray:
        return np.zeros((b, *shape))

    def whole(dtype: type, *shape: int) -> np.ndarray:
        return np.zeros((b, *shape), dtype)

    return WorldState(
        robot_pose=real(3),
        robot_velocity=real(2),
        pending_command=real(2),
        start_pose=real(3),
        goal=real(2),
        trail=real(5, 3),
        step_count=whole(np.int64),
        time_limit_s=real() + 60.0,
        collision_distance_m=real() + 0.3,
        goal_distance_m=real() + 0.3,
        clearance_m=real() + np.inf,
        clearance_people_m=real() + np.inf,
        collided=whole(np.bool_),
        collided_person=whole(np.int32) - 1,
        fault=whole(np.bool_),
        waypoints=real(num_waypoints, 2),
        num_waypoints=whole(np.int64),
        boxes=whole(np.float32, num_boxes, 8),
        num_boxes=whole(np.int64),
        cylinders=whole(np.float32, PARTS * p + num_static_cylinders, 5),
        num_cylinders=whole(np.int64),
        box_material=whole(np.uint8, num_boxes),
        num_glass=whole(np.int64),
        cylinder_material=whole(np.uint8, num_static_cylinders),
        ceiling_m=real() + np.inf,
        meshes=real(num_meshes, 6),
        num_meshes=whole(np.int64),
        pos=real(p, 2),
        vel=real(p, 2),
        person_goal=real(p, 2),
        preferred_speed=real(p),
        radius=real(p),
        height=real(p),
        heading=real(p),
        phase=real(p),
        behaviour=whole(np.int8, p),
        person_id=whole(np.int32, p) - 1,
        group=whole(np.int16, p) - 1,
        attitude=whole(np.int8, p),
        curious_s=real(p),
        entrance=real(p, 2) + np.nan,
        next_id=whole(np.int32),
        wander_area=real(4),
        change_rate=real(),
        net_places=whole(np.float32, NET_PLACES, 3),
        net_links=whole(np.int8, NET_PLACES, NET_LINKS) - 1,
        leg=whole(np.int8, p, 2) - 1,
        random=whole(np.uint64),
        trigger_distance=real() + np.inf,
        appear_distance=real(),
        spawn_time=real() + np.nan,
        spawn_line_x=real() + np.nan,
        recording=whole(np.int64) - 1,
        recording_step=whole(np.int64),
    )


def capacity(state: WorldState) -> tuple[int, int, int, int, int]:
    """People, boxes, static cylinders, waypoints and meshes that `state` has room for."""
    people = state.pos.shape[1]
    pillars = state.cylinders.shape[1] - PARTS * people
    return people, state.boxes.shape[1], pillars, state.waypoints.shape[1], state.meshes.shape[1]


def with_room(
    state: WorldState, people: int, boxes: int, static_cylinders: int, waypoints: int, meshes: int = 0
) -> WorldState:
    """The same worlds with room for at least so much; the same arrays where there already is."""
    have = capacity(state)
    wanted = (people, boxes, static_cylinders, waypoints, meshes)
    need = tuple(max(h, n) for h, n in zip(have, wanted, strict=True))
    if need == have:
        return state
    larger = allocate(len(state.goal), *need)
    for name, old, new in zip(WorldState._fields, state, larger, strict=True):
        if name == "cylinders":
            new[:, : PARTS * have[0]] = old[:, : PARTS * have[0]]
            new[:, PARTS * need[0] :][:, : have[2]] = old[:, PARTS * have[0] :]
        elif old.ndim >= 2:
            new[:, : old.shape[1]] = old
        else:
            new[:] = old
    larger.num_cylinders[:] += PARTS * (need[0] - have[0])
    return larger
