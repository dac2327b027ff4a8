"""Images of simulated worlds with labels of the people in them: what a detector is trained on and measured with."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from densecavoid.frames import CameraConfig, Command, require
from densecavoid.perception.detections import MAX_DETECTIONS
from densecavoid.perception.detector.labels import label_people
from densecavoid.perception.projection import camera_view
from densecavoid.sim.config import SimConfig
from densecavoid.sim.spec import Scenario
from densecavoid.sim.world import Simulator

_MM_PER_M = 1000.0


class Views(NamedTuple):
    """N labelled images. Label slots from `num_people` on hold no meaning."""

    depth_mm: np.ndarray  # u16 [N, height, width] along the optical axis; 0: no depth
    mount: np.ndarray  # f32 [N, 3] the camera's metres ahead, height (m) and pitch (rad)
    num_people: np.ndarray  # i32 [N] people of whom something is seen
    box: np.ndarray  # f32 [N, L, 4] u_min, v_min, u_max, v_max (labels.py)
    share: np.ndarray  # f32 [N, L] visible share
    place: np.ndarray  # f32 [N, L, 2] metres ahead and to the left of the robot's centre
    body: np.ndarray  # f32 [N, L, 2] radius and height, m
    world: np.ndarray  # i64 [N] seed of the world, so that images of one world can be kept together

    @property
    def depth_m(self) -> np.ndarray:
        """f32 [N, height, width], NaN where there is no depth."""
        return np.where(self.depth_mm > 0, self.depth_mm / np.float32(_MM_PER_M), np.float32(np.nan)).astype(np.float32)

    def rows(self, which: np.ndarray | slice) -> Views:
        """Some of the images."""
        return Views(*(array[which] for array in self))


def join(parts: list[Views]) -> Views:
    """All images of several."""
    return Views(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


@dataclass(frozen=True)
class ViewsConfig:
    """How the robot looks at the worlds."""

    camera: CameraConfig = field(default_factory=CameraConfig)
    vary_mount: bool = True
    """Cameras within 5 cm of the given height and 3 degrees of its pitch, up to 10 cm ahead; else all as given."""
    images_a_world: int = 6
    steps_between: int = 10
    """Control steps of driving from one image to the next."""
    worlds_at_once: int = 16
    keep_empty: float = 1.0
    """Share of the images without anybody that are kept."""
    threads: int = 1

    def __post_init__(self) -> None:
        for name in ("images_a_world", "steps_between", "worlds_at_once"):
            require(getattr(self, name) >= 1, f"ViewsConfig.{name}", getattr(self, name), "at least 1")
        require(0 < self.keep_empty <= 1, "ViewsConfig.keep_empty", self.keep_empty, "in (0, 1]")


def _mounted(camera: CameraConfig, rng: np.random.Generator) -> CameraConfig:
    return dataclasses.replace(
        camera,
        mount_height_m=camera.mount_height_m + float(rng.uniform(-0.05, 0.05)),
        mount_pitch_rad=camera.mount_pitch_rad + math.radians(float(rng.uniform(-3.0, 3.0))),
        mount_x_m=camera.mount_x_m + float(rng.uniform(0.0, 0.1)),
    )


def _allocate(count: int, camera: CameraConfig) -> Views:
    labels = (count, MAX_DETECTIONS)
    return Views(
        np.zeros((count, camera.height, camera.width), np.uint16),
        np.zeros((count, 3), np.float32),
        np.zeros(count, np.int32),
        np.zeros((*labels, 4), np.float32),
        np.zeros(labels, np.float32),
        np.zeros((*labels, 2), np.float32),
        np.zeros((*labels, 2), np.float32),
        np.zeros(count, np.int64),
    )


def take_views(
    scenario: Scenario,
    num_images: int,
    seed: int,
    config: ViewsConfig | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> Views:
    """Drives robots with `real` sensors at random through worlds of a scenario and looks around.

    The robot drives on at random velocities; a world ends early where it hits something.

    Args:
        scenario: where worlds are drawn from.
        num_images: N.
        seed: decides everything.
        progress: told how many images there are so far.
    """
    require(num_images >= 1, "num_images", num_images, "at least 1")
    config = config or ViewsConfig()
    rng = np.random.default_rng(seed)
    parts: list[Views] = []
    done = 0
    while done < num_images:
        camera = _mounted(config.camera, rng) if config.vary_mount else config.camera
        parts += _look_around(scenario, camera, config, rng)
        done = sum(len(part.num_people) for part in parts)
        progress(min(done, num_images))
    return join(parts).rows(slice(num_images))


def _look_around(
    scenario: Scenario, camera: CameraConfig, config: ViewsConfig, rng: np.random.Generator
) -> list[Views]:
    count = config.worlds_at_once
    sim = Simulator(scenario, count, SimConfig(camera=camera, sensors="real", threads=config.threads))
    seeds = rng.integers(0, 2**62, count)
    sim.reset(seeds)
    going = np.ones(count, np.bool_)
    parts = []
    for _ in range(config.images_a_world):
        velocity = np.stack([rng.uniform(0.0, 1.0, count), rng.uniform(-0.4, 0.4, count)]).astype(np.float32)
        for _ in range(int(rng.integers(1, 2 * config.steps_between))):
            sim.step(Command(*velocity))
            going &= ~sim.collided
        if not going.any():
            break
        views = look(sim, camera, seeds)
        parts.append(views.rows(going & ((views.num_people > 0) | (rng.random(count) < config.keep_empty))))
    return parts


def look(sim: Simulator, camera: CameraConfig, seeds: np.ndarray) -> Views:
    """One labelled image of each world as it is now. `camera` is the simulator's."""
    frame, truth = sim.sense(), sim.images()
    assert frame.truth is not None
    people = frame.truth.people
    views = _allocate(sim.num_worlds, camera)
    view = camera_view(camera)
    views.world[:] = seeds
    views.mount[:] = camera.mount_x_m, camera.mount_height_m, camera.mount_pitch_rad
    views.depth_mm[:] = np.nan_to_num(np.rint(frame.depth_m * _MM_PER_M), nan=0.0).astype(np.uint16)
    for b in range(sim.num_worlds):
        seen = frame.truth.robot_pose_w[b], frame.depth_m[b], truth.instance[b]
        labels = views.box[b], views.share[b], views.place[b], views.body[b]
        views.num_people[b] = label_people(sim.body_cylinders(b), people, b, *seen, view, *labels)
    return views
