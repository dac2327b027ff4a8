"""Colour, class and person of each pixel, against MuJoCo's rays, which say what they met and how it faces them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from densecavoid.frames import CameraConfig, Command
from densecavoid.scenarios import make_scenario
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.images import CLASSES
from densecavoid.sim.people import STANDING
from densecavoid.sim.spec import Crowd
from densecavoid.sim.world import SimConfig, Simulator
from scene import Scene

CAMERA = CameraConfig(width=96, height=72, mount_height_m=0.9, mount_pitch_rad=0.1, min_range_m=0.05, max_range_m=30.0)


def simulate(plan: FloorPlan, crowd: Crowd | None = None) -> Simulator:
    sim = Simulator(Scene(plan, crowd), 1)
    sim.reset(np.zeros(1, np.int64))
    return sim


def standing(*places: tuple[float, float]) -> Crowd:
    pos, one = np.array(places), np.ones(len(places))
    return Crowd(pos, pos - [1.0, 0.0], one, 0.25 * one, 1.7 * one, np.full(len(places), STANDING))


@pytest.mark.parametrize("name", ["dense-static", "random-sparse-ped", "dense-ped"])
def test_classes_and_people_are_those_that_mujocos_rays_meet(name):
    pytest.importorskip("mujoco")
    pytest.importorskip("pybullet")  # the same module builds both engines' worlds
    from peers.ray_engines import MujocoRays, camera_rays

    compared = 0
    for seed in range(4):
        sim = Simulator(make_scenario(name), 1)
        sim.reset(np.array([seed]))
        sim.step(Command(np.full(1, 0.4, np.float32), np.full(1, 0.3, np.float32)))
        images = sim.images(CAMERA)
        engine = MujocoRays(sim.floor_plan(0), sim.body_cylinders(0))
        hits = engine.caster(*camera_rays(CAMERA, sim.robot_pose[0]), CAMERA.max_range_m)()
        names = [engine.model.geom(i).name for i in range(engine.model.ngeom)]
        ids = sim.people().id[0]
        solid = hits.solid.reshape(CAMERA.height, CAMERA.width)
        inside = np.ones(solid.shape, bool)  # pixels whose four neighbours meet the same solid
        for axis, shift in ((0, 1), (0, -1), (1, 1), (1, -1)):
            inside &= np.roll(solid, shift, axis) == solid
        inside[[0, -1]] = inside[:, [0, -1]] = False
        for v, u in np.argwhere(inside):
            met = names[solid[v, u]] if solid[v, u] >= 0 else "nothing"
            kind = met.split("-")[0]
            expected = {"box": "thing", "pillar": "thing"}.get(kind, kind)
            assert CLASSES[images.segmentation[0, v, u]] == expected
            assert images.instance[0, v, u] == (ids[int(met.split("-")[1])] if kind == "person" else -1)
        compared += int(inside.sum())
        depth = np.where(np.isfinite(hits.distance), hits.distance, np.nan).reshape(solid.shape)
        np.testing.assert_allclose(images.depth_m[0][inside], depth[inside], atol=2e-3)
    assert compared > 4 * 0.7 * CAMERA.width * CAMERA.height


def test_the_depth_camera_and_the_images_show_the_same_depth():
    sim = Simulator(make_scenario("dense-ped"), 2)
    sim.reset(np.arange(2))
    np.testing.assert_allclose(sim.images().depth_m, sim.sense().depth_m, atol=1e-4)


def test_things_look_as_their_material_does():
    def centre(material: str) -> np.ndarray:
        plan = FloorPlan()
        plan.box(3.0, 0.0, 0.5, 4.0, z_max=2.0, material=material)
        return simulate(plan).images(CAMERA).rgb[0, 36, 48].astype(int)

    assert centre("plaster").min() > 150
    assert centre("black").max() < 40
    red, green, blue = centre("wood")
    assert red > green > blue
    red, green, blue = centre("plant")
    assert green > red and green > blue


def test_a_person_is_seen_through_glass_and_the_pane_beside():
    plan = FloorPlan()
    plan.wall(2.0, -2.0, 2.0, 2.0, 0.05, "glass")
    sim = simulate(plan, standing((4.0, 0.0)))
    images = sim.images(CAMERA)
    assert {CLASSES[k] for k in np.unique(images.segmentation[0, 20:30])} == {"glass", "person"}
    person = images.segmentation[0] == CLASSES.index("person")
    assert person.sum() > 100 and (images.instance[0][person] == 0).all()
    assert np.nanmedian(images.depth_m[0][person]) == pytest.approx(4.0, abs=0.3)


def test_outdoors_there_is_sky_and_indoors_a_ceiling():
    indoors, outdoors = (simulate(FloorPlan(ceiling_m=h)).images(CAMERA).segmentation[0] for h in (2.5, math.inf))
    assert CLASSES[indoors[0, 48]] == "ceiling" and CLASSES[outdoors[0, 48]] == "nothing"
    assert CLASSES[indoors[-1, 48]] == CLASSES[outdoors[-1, 48]] == "ground"


def test_only_marked_worlds_are_drawn_and_threads_change_nothing():
    pictures = []
    for threads in (1, 2):
        sim = Simulator(make_scenario("random-sparse-ped"), 3, SimConfig(threads=threads))
        sim.reset(np.arange(3))
        pictures.append(sim.images(which=np.array([True, False, True])))
    for a, b in zip(*pictures, strict=True):
        np.testing.assert_array_equal(a, b)
    assert not pictures[0].rgb[1].any() and pictures[0].rgb[2].any()


def test_any_resolution_shows_the_same_scene():
    sim = simulate(FloorPlan(), standing((3.0, 0.3), (4.0, -0.6)))
    small = sim.images(CAMERA).segmentation[0]
    large = sim.images(dataclasses.replace(CAMERA, width=480, height=360)).segmentation[0]
    person = CLASSES.index("person")
    assert (large == person).mean() == pytest.approx((small == person).mean(), rel=0.05)
