"""From frames to the prediction frame: who counts as seen, who is drawn, and what the pipeline remembers."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from densecavoid.frames import CameraConfig, Command
from densecavoid.perception.config import PerceptionConfig
from densecavoid.perception.pipeline import PeoplePipeline, expect_people
from densecavoid.perception.prediction_frame import Expected, draw_prediction
from densecavoid.perception.predictor.constant_velocity import ConstantVelocity
from densecavoid.perception.projection import camera_view
from densecavoid.perception.tracks import allocate_tracks
from densecavoid.perception.truth_detector import visible_fraction
from densecavoid.scenarios import make_scenario
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import STANDING, TRAVERSING
from densecavoid.sim.spec import Crowd, WorldSpec
from densecavoid.sim.world import SimConfig, Simulator

LEVEL = CameraConfig()
PITCHED = CameraConfig(mount_pitch_rad=-0.15, mount_x_m=0.1)
ALL = np.ones(1, np.bool_)


class Scene:
    """A robot at the origin looking along +x, and people."""

    name = "scene"

    def __init__(self, places, speed=0.0, walks_to=(0.0, 0.0), plan: FloorPlan | None = None) -> None:
        pos = np.array(places, float).reshape(-1, 2)
        n = len(pos)
        goal = pos + np.array(walks_to)
        kind = np.full(n, TRAVERSING if speed else STANDING)
        crowd = Crowd(pos, goal, np.full(n, max(speed, 0.1)), np.full(n, 0.25), np.full(n, 1.7), kind)
        self.spec = WorldSpec("scene", plan or FloorPlan(), (0.0, 0.0, 0.0), (20.0, 0.0), crowd)

    def spawn(self, rng):
        return self.spec


def begin(scene, camera=LEVEL) -> Simulator:
    sim = Simulator(scene, 1, SimConfig(camera=camera, threads=1))
    sim.reset(np.zeros(1, np.int64))
    return sim


def fraction(sim: Simulator, forward: float, left: float) -> float:
    camera = sim.config.camera
    return visible_fraction(sim.sense().depth_m[0], forward - camera.mount_x_m, left, 0.25, 1.7, camera_view(camera))


@pytest.mark.parametrize("camera", [LEVEL, PITCHED], ids=["level", "pitched"])
def test_only_people_the_camera_shows_are_seen(camera):
    sim = begin(Scene([(3.0, 0.0)]), camera)
    assert fraction(sim, 3.0, 0.0) > 0.9  # in plain view
    assert fraction(sim, 3.0, 1.0) == 0.0  # nobody there
    assert fraction(begin(Scene([(1.2, 0.0)]), camera), 1.2, 0.0) == 0.0  # nearer than the camera measures
    assert fraction(begin(Scene([(6.0, 0.0)]), camera), 6.0, 0.0) == 0.0  # farther
    aside = (3.0 - camera.mount_x_m) * math.tan(math.radians(30))
    edge = fraction(begin(Scene([(3.0, aside)]), camera), 3.0, aside)
    assert edge == pytest.approx(0.5, abs=0.12)  # half outside the image
    wall = FloorPlan()
    wall.box(2.0, 0.0, 0.1, 2.0, z_max=2.0)
    assert fraction(begin(Scene([(3.0, 0.0)], plan=wall), camera), 3.0, 0.0) == 0.0  # hidden
    wall = FloorPlan()
    wall.box(2.0, 1.0, 0.1, 2.0, z_max=2.0)
    half = fraction(begin(Scene([(3.0, 0.0)], plan=wall), camera), 3.0, 0.0)
    assert half == pytest.approx(0.5, abs=0.12)


def overlap_of(first, second) -> float:
    """Intersection over union of what is dark."""
    return float(((first < 255) & (second < 255)).sum() / ((first < 255) | (second < 255)).sum())


@pytest.mark.parametrize("camera", [LEVEL, PITCHED], ids=["level", "pitched"])
@pytest.mark.parametrize("people_from", ["truth", "boxes"])
def test_walking_person_is_foreseen(camera, people_from):
    sim = begin(Scene([(4.0, 1.5)], speed=1.0, walks_to=(0.0, -30.0)), camera)
    pipeline = PeoplePipeline(PerceptionConfig(camera=camera, people_from=people_from, horizons_s=(0.4,), threads=1), 1)
    for _ in range(14):
        pipeline.update(sim.sense(), ALL)
        sim.step(Command(np.zeros(1, np.float32), np.zeros(1, np.float32)))
    pipeline.update(sim.sense(), ALL)
    people = sim.people()
    then = (people.pos_w + 0.4 * people.vel_w)[0, :1, None].astype(float)
    truth = Expected(then, np.zeros((1, 1, 3)), np.array([[0.25, 1.7]]), np.array([0, 1]))
    image = np.empty((camera.height, camera.width), np.uint8)
    shade = np.zeros(1, np.uint8)
    draw_prediction(image, truth, 0, np.zeros(3), 0.0, 0.0, np.zeros(1), shade, camera_view(camera), False)
    assert overlap_of(pipeline.prediction[0], image) > (0.8 if people_from == "truth" else 0.6)


def test_only_who_is_surely_a_person_is_foreseen_each_in_their_own_world():
    tracks = allocate_tracks(3)
    for b, t in ((0, 1), (1, 0), (1, 5), (2, 2)):
        tracks.live[b, t] = tracks.confirmed[b, t] = True
        tracks.state[b, t] = 1.0 * b, 1.0 * t, 0.5, -1.0
        tracks.history[b, t, -1] = tracks.state[b, t, :2]
        tracks.history_count[b, t] = 1
        tracks.body[b, t] = 0.2 + 0.01 * t, 1.7
    tracks.live[1, 3] = True  # perhaps a person
    expected = expect_people(tracks, ConstantVelocity(), (0.4, 1.0), np.array([True, True, False]))
    np.testing.assert_array_equal(expected.first, [0, 1, 3, 3])
    wanted = [[[0.2, 0.6], [0.5, 0.0]], [[1.2, -0.4], [1.5, -1.0]], [[1.2, 4.6], [1.5, 4.0]]]
    np.testing.assert_allclose(expected.pos, wanted, atol=1e-6)
    np.testing.assert_allclose(expected.body[:, 0], [0.21, 0.2, 0.25])


def run(pipeline: PeoplePipeline, sim: Simulator, steps: int) -> list[np.ndarray]:
    frames, worlds = [], sim.num_worlds
    for _ in range(steps):
        pipeline.update(sim.sense(), np.ones(worlds, np.bool_))
        frames.append(pipeline.prediction.copy())
        sim.step(Command(np.full(worlds, 0.3, np.float32), np.zeros(worlds, np.float32)))
    return frames


@pytest.mark.parametrize("people_from", ["truth", "boxes"])
def test_pipeline_goes_on_from_its_state_bit_for_bit_whatever_the_threads(people_from):
    config = PerceptionConfig(people_from=people_from, horizons_s=(0.4, 1.2), soft=True, threads=1)
    sim = Simulator(make_scenario("dense-ped"), 5, SimConfig(sensors="real", threads=1))
    sim.reset(np.arange(5))
    pipeline = PeoplePipeline(config, 5)
    run(pipeline, sim, 8)
    saved, world = pipeline.state_dict(), sim.state_dict()
    frames = run(pipeline, sim, 6)
    assert min(frame.min() for frame in frames) < 128
    again = PeoplePipeline(dataclasses.replace(config, threads=2), 5)
    again.load_state_dict(saved)
    sim.load_state_dict(world)
    np.testing.assert_array_equal(run(again, sim, 6), frames)


def test_reset_forgets_the_marked_worlds_alone():
    sim = Simulator(Scene([(3.0, 0.0)]), 2, SimConfig(threads=1))
    sim.reset(np.arange(2))
    pipeline = PeoplePipeline(PerceptionConfig(threads=1), 2)
    before = run(pipeline, sim, 5)[-1]
    assert (before < 255).any(axis=(1, 2)).all()
    pipeline.reset(np.array([True, False]))
    assert (pipeline.prediction[0] == 255).all() and not pipeline.tracks.live[0].any()
    np.testing.assert_array_equal(pipeline.prediction[1], before[1])


def test_nothing_is_drawn_and_no_truth_is_needed_where_nobody_is_looked_for():
    config = PerceptionConfig(people_from="nothing")
    assert not config.privileged
    pipeline = PeoplePipeline(config, 1)
    pipeline.update(dataclasses.replace(begin(Scene([(3.0, 0.0)])).sense(), truth=None), ALL)
    assert (pipeline.prediction == 255).all()


@pytest.mark.parametrize("people_from", ["truth", "boxes"])
def test_missing_truth_is_named(people_from):
    frame = dataclasses.replace(begin(Scene([(3.0, 0.0)])).sense(), truth=None)
    with pytest.raises(ValueError, match=f"no ground truth.*{people_from}"):
        PeoplePipeline(PerceptionConfig(people_from=people_from), 1).update(frame, ALL)


@pytest.mark.parametrize("horizons_s", [(), (0.4, 0.4), (0.4, 0.1), (0.0,), (6.0,)])
def test_horizons_that_cannot_be_are_named(horizons_s):
    with pytest.raises(ValueError, match="horizons_s"):
        PerceptionConfig(horizons_s=horizons_s)
