"""Perception of people: boxes against corners projected by hand, occlusion, and the prediction frame."""

from __future__ import annotations

import math

import numpy as np
import pytest

from densecavoid.env.observation import Observer, ObserverConfig
from densecavoid.frames import CameraConfig, Command
from densecavoid.perception.prediction_frame import draw_prediction
from densecavoid.perception.projection import body_box
from densecavoid.perception.tracks import allocate_tracks
from densecavoid.perception.truth_detector import visible_fraction
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import STANDING, TRAVERSING
from densecavoid.sim.spec import Crowd, WorldSpec
from densecavoid.sim.world import Simulator

CAMERA = CameraConfig()
INTRINSICS = (*CAMERA.focal_px, CAMERA.width, CAMERA.height, CAMERA.mount_height_m)


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


def begin(scene: Scene) -> tuple[Simulator, Observer]:
    sim = Simulator(scene, 1)
    sim.reset(np.zeros(1, np.int64))
    return sim, Observer(ObserverConfig(horizon_s=0.4), 1)


def box_by_corners(forward, left, radius=0.25, height=1.7):
    """The box from densely sampled silhouette points, sides only by tangent directions."""
    angle = np.linspace(0, 2 * math.pi, 20_000)
    x, y = forward + radius * np.cos(angle), left + radius * np.sin(angle)
    fx, fy = CAMERA.focal_px
    u = CAMERA.width / 2 - fx * y / x
    v = [CAMERA.height / 2 - fy * (z - CAMERA.mount_height_m) / forward for z in (height, 0.0)]
    return u.min(), v[0], u.max(), v[1]


@pytest.mark.parametrize("place", [(2.0, 0.0), (3.0, 1.2), (4.5, -2.0), (1.0, 0.4)])
def test_box_touches_the_silhouette(place):
    box = body_box(*place, 0.25, 1.7, *INTRINSICS)
    np.testing.assert_allclose(box, box_by_corners(*place), atol=1e-3)


def test_nobody_behind_or_on_the_camera_has_a_box():
    for place in ((-2.0, 0.0), (0.2, 0.0), (0.1, 3.0)):
        u_min, _, u_max, _ = body_box(*place, 0.25, 1.7, *INTRINSICS)
        assert u_max < u_min


def fraction(sim: Simulator, forward: float, left: float) -> float:
    depth = sim.sense().depth_m[0]
    return visible_fraction(depth, forward, left, 0.25, 1.7, *CAMERA.focal_px, CAMERA.mount_height_m)


def test_only_people_the_camera_shows_are_seen():
    sim, _ = begin(Scene([(3.0, 0.0)]))
    assert fraction(sim, 3.0, 0.0) > 0.9  # in plain view
    assert fraction(sim, 3.0, 1.0) == 0.0  # nobody there
    assert fraction(begin(Scene([(1.2, 0.0)]))[0], 1.2, 0.0) == 0.0  # nearer than the camera measures
    assert fraction(begin(Scene([(6.0, 0.0)]))[0], 6.0, 0.0) == 0.0  # farther
    edge = fraction(begin(Scene([(3.0, 3.0 * math.tan(math.radians(30)))]))[0], 3.0, 3.0 * math.tan(math.radians(30)))
    assert edge == pytest.approx(0.5, abs=0.12)  # half outside the image
    wall = FloorPlan()
    wall.box(2.0, 0.0, 0.1, 2.0, z_max=2.0)
    assert fraction(begin(Scene([(3.0, 0.0)], plan=wall))[0], 3.0, 0.0) == 0.0  # hidden
    wall = FloorPlan()
    wall.box(2.0, 1.0, 0.1, 2.0, z_max=2.0)
    assert fraction(begin(Scene([(3.0, 0.0)], plan=wall))[0], 3.0, 0.0) == pytest.approx(0.5, abs=0.12)


def expected_frame(boxes) -> np.ndarray:
    image = np.full((CAMERA.height, CAMERA.width), 255, np.uint8)
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width] + 0.5
    for u_min, v_min, u_max, v_max in boxes:
        image[(u >= u_min) & (u <= u_max) & (v >= v_min) & (v <= v_max)] = 0
    return image


def test_prediction_frame_is_black_where_people_will_be_when_the_robot_has_moved():
    tracks = allocate_tracks(1)
    tracks.live[0, :3] = tracks.confirmed[0, :2] = True
    tracks.state[0, 2] = 2.0, 0.0, 0.0, 0.0  # perhaps a person: not drawn
    tracks.body[0, 2] = 0.25, 1.7
    tracks.state[0, 0] = 4.0, 0.5, -1.0, 0.2
    tracks.state[0, 1] = 3.0, -1.0, 0.0, 0.5
    tracks.body[0, :2] = 0.25, 1.7
    image = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    draw_prediction(image, tracks, 0, np.zeros(3), 1.0, 0.4, 0.4, *CAMERA.focal_px, CAMERA.mount_height_m)
    # the robot by hand: radius v / w = 2.5 m, turned by .16 rad
    x, y, yaw = 2.5 * math.sin(0.16), 2.5 * (1 - math.cos(0.16)), 0.16
    boxes = []
    for px, py in ((3.6, 0.58), (3.0, -0.8)):
        forward = math.cos(yaw) * (px - x) + math.sin(yaw) * (py - y)
        left = math.cos(yaw) * (py - y) - math.sin(yaw) * (px - x)
        boxes.append(box_by_corners(forward, left, 0.25, 1.7))
    np.testing.assert_array_equal(image, expected_frame(boxes))


def test_walking_person_is_predicted_through_the_whole_pipeline():
    sim, observer = begin(Scene([(4.0, 1.5)], speed=1.0, walks_to=(0.0, -30.0)))
    for _ in range(14):
        observer.observe(sim.sense())
        sim.step(Command(np.zeros(1), np.zeros(1)))
    observation = observer.observe(sim.sense())
    then = sim.people().pos_w[0, 0] + 0.4 * sim.people().vel_w[0, 0]
    truth = expected_frame([box_by_corners(then[0], then[1])])
    ours = observation.prediction[0]
    union, both = ((truth == 0) | (ours == 0)).sum(), ((truth == 0) & (ours == 0)).sum()
    assert both / union > 0.8


def test_an_observer_without_people_draws_an_empty_prediction():
    sim, _ = begin(Scene([(3.0, 0.0)]))
    observer = Observer(ObserverConfig(people_from="nothing"), 1)
    assert not observer.privileged
    assert (observer.observe(sim.sense()).prediction == 255).all()
