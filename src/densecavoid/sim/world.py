"""The simulator: B worlds reset from a scenario, stepped by commands, and seen through a lidar and a depth camera."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from densecavoid.frames import CameraConfig, Command, People, SensorFrame, Truth, require
from densecavoid.sim import kernels
from densecavoid.sim._jit import for_worlds, share_compilation, threads_for
from densecavoid.sim.clearance import check_can_begin
from densecavoid.sim.config import SimConfig
from densecavoid.sim.crowds.placing import place_crowd
from densecavoid.sim.crowds.recorded import Recordings, no_recordings
from densecavoid.sim.crowds.recording import Recording
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.images import Images, take_images
from densecavoid.sim.materials import MATERIALS
from densecavoid.sim.mesh import Mesh, MeshSet, mesh_set, place_rows
from densecavoid.sim.people import ABSENT, PARTS
from densecavoid.sim.robot import Robot
from densecavoid.sim.sensors import SensorSuite
from densecavoid.sim.spec import Scenario, WorldSpec
from densecavoid.sim.state import WorldState, allocate, capacity, with_room

_MOVES = {"anticipation": (None, None), "social-force": (True, None), "orca": (None, True)}
"""What tells `kernels.advance` how people move."""


class Simulator:
    """B independent worlds in step. A world's course depends on its scenario, its seed and its commands alone."""

    def __init__(self, scenario: Scenario, num_worlds: int, config: SimConfig | None = None) -> None:
        """Makes empty worlds; `reset` fills them.

        Args:
            scenario: where worlds are drawn from; may be exchanged later, for the worlds reset after that.
            num_worlds: B.

        Raises:
            ValueError: if `num_worlds` is not positive.
        """
        require(num_worlds >= 1, "num_worlds", num_worlds, "at least 1")
        share_compilation()
        self.scenario = scenario
        self.num_worlds = num_worlds
        self.config = config or SimConfig()
        self.scenario_name = [""] * num_worlds
        self._state = allocate(num_worlds, 0, 0, 0, 0)
        self._recordings = no_recordings()
        self._known_recordings: list[Recording] = []
        self._known_meshes: list[Mesh] = []
        self._meshes: MeshSet | None = None
        self._replay_reactive = np.zeros(num_worlds, np.bool_)
        self._sensors = SensorSuite(self.config, num_worlds)
        robot = self.config.robot
        self._robot = Robot(
            self.config.dynamics == "dynamic",
            float(robot.max_linear_acceleration),
            float(robot.max_angular_acceleration),
            float(robot.radius_m),
            float(robot.height_m),
        )

    # -- the episode ---------------------------------------------------------------------------------------------------

    def reset(self, seeds: Int[np.ndarray, "B"], which: Bool[np.ndarray, "B"] | None = None) -> None:
        """Draws a new world for each marked one (all, without `which`) from (scenario, its seed).

        Raises:
            ValueError: naming the scenario, if a world of it has no room, or somebody would start inside a thing.
        """
        require(
            len(seeds) == self.num_worlds, "seeds", f"{len(seeds)} long", f"one for each of {self.num_worlds} worlds"
        )
        which = np.ones(self.num_worlds, np.bool_) if which is None else which
        for b in np.flatnonzero(which):
            rng = np.random.default_rng(int(seeds[b]))
            self._fill(int(b), self._spawn(rng), rng)
        self._sensors.reset(seeds, which)
        self._advance(which, np.zeros((self.num_worlds, 2)), 0)

    def step(self, command: Command) -> None:
        """Carries out a command for one control step. Velocities are limited to the robot's.

        Raises:
            ValueError: if a velocity is NaN or infinite, or the batch has the wrong size.
        """
        robot = self.config.robot
        velocities = np.stack([command.linear_velocity, command.angular_velocity], axis=1).astype(np.float64)
        require(velocities.shape == (self.num_worlds, 2), "command", velocities.shape, f"({self.num_worlds}, 2)")
        require(bool(np.isfinite(velocities).all()), "command", velocities, "finite velocities")
        velocities[:, 0] = np.clip(velocities[:, 0], 0.0, robot.max_linear_velocity)
        velocities[:, 1] = np.clip(velocities[:, 1], -robot.max_angular_velocity, robot.max_angular_velocity)
        self._advance(np.ones(self.num_worlds, np.bool_), velocities, self.config.sub_steps)

    def sense(self, which: Bool[np.ndarray, "B"] | None = None) -> SensorFrame:
        """What the sensors give now. Worlds not marked in `which` keep their last scan and image.

        Sensors with a latency or a rate of their own, and drifting odometry, remember what they measured when this was
        called: call it once each control step.
        """
        scan_m, depth_m, odom_pose = self._sensors.sense(self._state, which, self._meshes)
        return SensorFrame(
            time_s=self.time_s,
            scan_m=scan_m,
            depth_m=depth_m,
            odom_pose=odom_pose,
            velocity=self.robot_velocity.astype(np.float32),
            goal_odom=self.goal,
            truth=Truth(self.robot_pose, self.people()),
        )

    def images(self, camera: CameraConfig | None = None, which: Bool[np.ndarray, "B"] | None = None) -> Images:
        """Colour, depth, class and person of every pixel, exact; of the marked worlds (all, without `which`).

        Args:
            camera: where it is on the robot and what it sees; the configured depth camera unless given. Its rate and
                latency play no part.
        """
        which = np.ones(self.num_worlds, np.bool_) if which is None else which
        return take_images(self._state, camera or self.config.camera, which, self.config.threads, self._meshes)

    # -- what happened -------------------------------------------------------------------------------------------------

    @property
    def time_s(self) -> Float[np.ndarray, "B"]:
        """Since the start of each episode."""
        return self._state.step_count * self.config.control_dt_s

    @property
    def robot_pose(self) -> Float[np.ndarray, "B 3"]:
        return self._state.robot_pose

    @property
    def robot_velocity(self) -> Float[np.ndarray, "B 2"]:
        return self._state.robot_velocity

    @property
    def start_pose(self) -> Float[np.ndarray, "B 3"]:
        return self._state.start_pose

    @property
    def goal(self) -> Float[np.ndarray, "B 2"]:
        return self._state.goal

    @property
    def goal_distance_m(self) -> Float[np.ndarray, "B"]:
        """From the robot's centre to the goal."""
        offset = self._state.goal - self._state.robot_pose[:, :2]
        return np.hypot(offset[:, 0], offset[:, 1])

    @property
    def waypoints(self) -> tuple[Float[np.ndarray, "B W 2"], Int[np.ndarray, "B"]]:
        """Places on the way, and how many of them each world has."""
        return self._state.waypoints, self._state.num_waypoints

    @property
    def time_limit_s(self) -> Float[np.ndarray, "B"]:
        return self._state.time_limit_s

    @property
    def clearance_m(self) -> Float[np.ndarray, "B"]:
        """Least distance from the robot's centre to any surface during the last control step."""
        return self._state.clearance_m

    @property
    def clearance_people_m(self) -> Float[np.ndarray, "B"]:
        """The same to people's bodies; inf where there is nobody."""
        return self._state.clearance_people_m

    @property
    def collided(self) -> Bool[np.ndarray, "B"]:
        return self._state.collided

    @property
    def collided_person(self) -> Int[np.ndarray, "B"]:
        """Slot of the person the robot collided with; -1 for a thing or no collision."""
        return self._state.collided_person

    @property
    def fault(self) -> Bool[np.ndarray, "B"]:
        """Collided with a person while the robot moved towards them (BENCHMARK, Real crowds)."""
        return self._state.fault

    @property
    def succeeded(self) -> Bool[np.ndarray, "B"]:
        return (self.goal_distance_m < self._state.goal_distance_m) & ~self._state.collided

    @property
    def timed_out(self) -> Bool[np.ndarray, "B"]:
        late = self.time_s >= self._state.time_limit_s - 1e-9
        return late & ~self._state.collided & ~self.succeeded

    @property
    def done(self) -> Bool[np.ndarray, "B"]:
        return self._state.collided | self.succeeded | self.timed_out

    @property
    def spawn_time_s(self) -> Float[np.ndarray, "B"]:
        """When people appeared suddenly; NaN where they have not."""
        return self._state.spawn_time

    @property
    def spawn_line_x(self) -> Float[np.ndarray, "B"]:
        """Where along x the people who appeared stand; NaN where they have not."""
        return self._state.spawn_line_x

    def people(self) -> People:
        """Everybody, as they are."""
        state = self._state
        return People(
            pos_w=state.pos.astype(np.float32),
            vel_w=state.vel.astype(np.float32),
            radius_m=state.radius.astype(np.float32),
            height_m=state.height.astype(np.float32),
            active=state.behaviour != ABSENT,
            id=state.person_id.copy(),
        )

    @property
    def heading_rad(self) -> Float[np.ndarray, "B P"]:
        """Where everybody looks, in the order of `people()`; kept by those who stand."""
        return self._state.heading

    def floor_plan(self, b: int) -> FloorPlan:
        """What stands in world b, people left out."""
        state = self._state
        plan = FloorPlan(float(state.ceiling_m[b]))
        boxes = state.boxes[b, : state.num_boxes[b]].tolist()
        for (x, y, cos, sin, half_length, half_width, z_min, z_max), number in zip(
            boxes, state.box_material[b], strict=False
        ):
            yaw, material = float(np.arctan2(sin, cos)), MATERIALS[number].name
            plan.box(x, y, 2 * half_length, 2 * half_width, yaw, z_min, z_max, material)
        pillars = state.cylinders[b, PARTS * state.pos.shape[1] : state.num_cylinders[b]].tolist()
        for row, number in zip(pillars, state.cylinder_material[b], strict=False):
            plan.pillar(*row, material=MATERIALS[number].name)
        for number, x, y, z, cos, sin in state.meshes[b, : state.num_meshes[b]].tolist():
            plan.mesh(self._known_meshes[int(number)], x, y, float(np.arctan2(sin, cos)), z)
        return plan

    def body_cylinders(self, b: int) -> Float[np.ndarray, "P parts 5"]:
        """Everybody's parts (`people.LEFT_LEG`, ...) in world b: x, y, radius, z_min, z_max; without radius: nobody."""
        slots = self._state.pos.shape[1]
        return self._state.cylinders[b, : PARTS * slots].astype(np.float64).reshape(slots, PARTS, 5)

    def nearest_surface_m(self, b: int, points: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N"]:
        """Distance from each point to the nearest surface in world b that the robot could hit."""
        distances = np.empty(len(points))
        points = np.asarray(points, np.float64)
        kernels.surfaces_at(self._state, b, points, self.config.robot.height_m, self._meshes, distances)
        return distances

    @property
    def bytes_per_world(self) -> int:
        """Memory of one world with its last scan and depth image; the same for all, as large as the largest needs."""
        return (sum(array.nbytes for array in self._state) + self._sensors.nbytes) // self.num_worlds

    # -- saving --------------------------------------------------------------------------------------------------------

    def state_dict(self) -> dict[str, np.ndarray]:
        """Everything that decides how the worlds go on, as arrays."""
        arrays = {name: np.copy(value) for name, value in self._state._asdict().items()}
        arrays["scenario_name"] = np.array(self.scenario_name)
        arrays["replay_reactive"] = self._replay_reactive.copy()
        return arrays | self._sensors.state_dict()

    def load_state_dict(self, arrays: dict[str, np.ndarray]) -> None:
        """Goes on from a `state_dict` of a simulator with as many worlds.

        Raises:
            ValueError: if the number of worlds differs, or a world replays a recording or shows a mesh that this
                simulator has not met.
        """
        require(len(arrays["goal"]) == self.num_worlds, "saved worlds", len(arrays["goal"]), str(self.num_worlds))
        latest = int(arrays["recording"].max())
        require(latest < len(self._known_recordings), "saved recording", latest, "one that was loaded before")
        known = len(self._known_meshes)
        for places, count in zip(arrays["meshes"], arrays["num_meshes"], strict=True):
            latest = int(places[:count, 0].max(initial=-1))
            require(latest < known, "saved mesh", latest, "one that was loaded before")
        self._state = WorldState(**{name: np.array(arrays[name]) for name in WorldState._fields})
        self.scenario_name = [str(name) for name in arrays["scenario_name"]]
        self._replay_reactive = np.array(arrays["replay_reactive"])
        self._sensors.load_state_dict(arrays)

    # -- inside --------------------------------------------------------------------------------------------------------

    def _advance(self, which: Bool[np.ndarray, "B"], velocities: Float[np.ndarray, "B 2"], sub_steps: int) -> None:
        for_worlds(
            kernels.advance,
            self.num_worlds,
            threads_for(which, self.config.threads),
            self._state,
            which,
            self._recordings,
            self._meshes,
            self._replay_reactive,
            *_MOVES[self.config.motion],
            velocities,
            self._robot,
            sub_steps,
            self.config.physics_dt_s,
        )

    def _spawn(self, rng: np.random.Generator) -> WorldSpec:
        try:
            return self.scenario.spawn(rng)
        except ValueError as error:
            name = self.scenario.name
            raise error if str(error).startswith(name) else ValueError(f"{name}: {error}") from error

    def _fill(self, b: int, spec: WorldSpec, rng: np.random.Generator) -> None:
        plan, crowd = spec.floor_plan.packed(), spec.crowd
        check_can_begin(spec, self.config.robot.height_m)
        boxes, cylinders, places = plan.boxes, plan.cylinders, spec.floor_plan.meshes
        self._state = with_room(
            self._state, spec.people_slots, len(boxes), len(cylinders), len(spec.waypoints), len(places)
        )
        state = self._state
        slots = capacity(state)[0]
        self.scenario_name[b] = spec.scenario

        state.robot_pose[b] = state.start_pose[b] = spec.start_pose
        state.robot_velocity[b] = state.pending_command[b] = 0.0
        state.trail[b] = 0.0
        state.goal[b] = spec.goal
        state.step_count[b] = 0
        state.time_limit_s[b] = spec.time_limit_s
        state.collision_distance_m[b] = spec.collision_distance_m
        state.goal_distance_m[b] = spec.goal_distance_m
        state.collided[b] = state.fault[b] = False
        state.collided_person[b] = -1
        state.num_waypoints[b] = len(spec.waypoints)
        state.waypoints[b, : len(spec.waypoints)] = spec.waypoints

        state.num_boxes[b] = len(boxes)
        state.boxes[b, : len(boxes)] = boxes
        state.num_cylinders[b] = PARTS * slots + len(cylinders)
        state.cylinders[b, PARTS * slots : state.num_cylinders[b]] = cylinders
        state.box_material[b, : len(boxes)] = plan.box_material
        state.num_glass[b] = plan.num_glass
        state.cylinder_material[b, : len(cylinders)] = plan.cylinder_material
        state.ceiling_m[b] = spec.floor_plan.ceiling_m
        state.num_meshes[b] = len(places)
        state.meshes[b, : len(places)] = place_rows(places, [self._mesh_number(place.mesh) for place in places])

        state.trigger_distance[b] = spec.appearance.trigger_distance_m if spec.appearance else np.inf
        state.appear_distance[b] = spec.appearance.distance_m if spec.appearance else 0.0
        state.spawn_time[b] = state.spawn_line_x[b] = np.nan

        state.recording[b] = -1
        self._replay_reactive[b] = False
        if spec.replay is not None:
            reactive = spec.replay.reactive or self.config.people != "scripted"
            self._replay_reactive[b] = reactive
            state.recording[b] = self._recording_index(spec.replay.recording)
            state.recording_step[b] = round(spec.replay.start_s / self.config.physics_dt_s)
        reactive = bool(self._replay_reactive[b])
        place_crowd(state, b, crowd, self.config, reactive, spec.appearance is not None, rng)

    def _mesh_number(self, mesh: Mesh) -> int:
        """The mesh's place in the simulator's set, into which it is taken at first sight."""
        if mesh not in self._known_meshes:
            self._known_meshes.append(mesh)
            self._meshes = mesh_set(tuple(self._known_meshes))
        return self._known_meshes.index(mesh)

    def _recording_index(self, recording: Recording) -> int:
        """The recording's place in the simulator's set, into which it is taken at first sight."""
        for k, known in enumerate(self._known_recordings):
            if known is recording:
                return k
        require(
            abs(recording.dt_s - self.config.physics_dt_s) < 1e-9,
            "Recording.dt_s",
            recording.dt_s,
            f"the simulator's physics_dt_s {self.config.physics_dt_s}",
        )
        self._known_recordings.append(recording)
        old = self._recordings
        frames = recording.frame_start.astype(np.int64) + len(old.rows)
        self._recordings = Recordings(
            first_step=np.append(old.first_step, len(old.frame_start) - 1),
            num_steps=np.append(old.num_steps, len(frames) - 1),
            first_person=np.append(old.first_person, len(old.radius)),
            frame_start=np.concatenate([old.frame_start[:-1], frames]),
            rows=np.concatenate([old.rows, recording.state_w]),
            person=np.concatenate([old.person, recording.person]),
            radius=np.concatenate([old.radius, recording.radius_m]),
            height=np.concatenate([old.height, recording.height_m]),
        )
        return len(self._known_recordings) - 1
