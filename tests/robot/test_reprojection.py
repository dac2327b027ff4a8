"""Images of cameras that sit elsewhere become the policy's: against what a camera there sees of the same scene, and
point by point against projection by matrices."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from densecavoid.frames import CameraConfig
from densecavoid.robot.camera_mount import CameraMount
from densecavoid.robot.messages import DepthImage, Intrinsics
from densecavoid.robot.reprojection import reproject
from densecavoid.sim.config import SimConfig
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import STANDING
from densecavoid.sim.spec import Crowd
from densecavoid.sim.world import Simulator
from scene import Scene

POLICYS = CameraConfig()


def room() -> Scene:
    """A table-high box, a pillar, two people and a wall behind them."""
    plan = FloorPlan()
    plan.box(3.0, 0.8, 0.5, 0.6, yaw=0.4, z_max=0.7)
    plan.pillar(2.4, -0.4, 0.1)
    plan.box(4.6, 0.0, 0.1, 8.0, z_max=2.5)
    pos, one = np.array([[3.2, -1.0], [2.6, 0.25]]), np.ones(2)
    return Scene(plan, Crowd(pos, pos - [1.0, 0.0], one, 0.25 * one, 1.7 * one, np.full(2, STANDING)))


def picture(camera: CameraConfig) -> np.ndarray:
    simulator = Simulator(room(), 1, SimConfig(camera=camera, threads=1))
    simulator.reset(np.zeros(1, np.int64))
    return simulator.sense().depth_m[0].copy()


def image(depth_m: np.ndarray) -> DepthImage:
    return DepthImage(0.0, "camera", depth_m.astype(np.float32))


def matrices(mount: CameraMount) -> tuple[np.ndarray, np.ndarray]:
    """Rotation by the textbook's three, with the columns right, down, ahead, and the place."""
    (cr, sr), (cp, sp), (cy, sy) = (
        (math.cos(a), math.sin(a)) for a in (mount.roll_rad, mount.pitch_rad, mount.yaw_rad)
    )
    yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    pitch = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    roll = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    optical = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    return yaw @ pitch @ roll @ optical, np.array([mount.x_m, mount.y_m, mount.height_m])


def seen_by_both(depth_m: np.ndarray, other_m: np.ndarray, other: CameraConfig) -> np.ndarray:
    """Pixels of the policy's camera whose point the other camera shows too: its image has that depth there."""
    turn, place = matrices(CameraMount.of(POLICYS))
    right, down = -POLICYS.column_slopes[None], -POLICYS.row_slopes[:, None]
    rays = np.stack(np.broadcast_arrays(right, down, 1.0), axis=-1)
    other_turn, other_place = matrices(CameraMount.of(other))
    x, y, z = np.moveaxis((place + depth_m[..., None] * rays @ turn.T - other_place) @ other_turn, -1, 0)
    u = np.nan_to_num(other.width / 2 - 0.5 + other.focal_px[0] * x / z, nan=-9.0).round().astype(int)
    v = np.nan_to_num(other.height / 2 - 0.5 + other.focal_px[1] * y / z, nan=-9.0).round().astype(int)
    within = (u >= 0) & (u < other.width) & (v >= 0) & (v < other.height)
    shown = other_m[v.clip(0, other.height - 1), u.clip(0, other.width - 1)]
    return within & (np.abs(shown / z - 1) < 0.1)


def away_from_edges(depth_m: np.ndarray) -> np.ndarray:
    """Pixels whose neighbours are of the same plane: beside them is neither a silhouette nor a crease."""
    padded = np.pad(1 / depth_m, 1, mode="edge")
    rows, columns = depth_m.shape
    (nw, n, ne), (w, here, e), (sw, s, se) = (
        [padded[v : v + rows, u : u + columns] for u in range(3)] for v in range(3)
    )
    bends = [np.abs(one - 2 * here + other) for one, other in ((nw, se), (n, s), (ne, sw), (w, e))]
    steps = [np.abs(around - here) for around in (nw, n, ne, w, e, sw, s, se)]
    return (np.max(bends, axis=0) < 0.01) & (np.max(steps, axis=0) < 0.1)


@pytest.mark.parametrize(("size", "share"), [((80, 60), 0.975), ((160, 120), 0.995), ((640, 480), 0.995)])
@pytest.mark.parametrize(
    "place",
    [
        {"mount_height_m": 0.6, "mount_pitch_rad": 0.2, "mount_x_m": 0.1},
        {"mount_height_m": 0.25, "mount_pitch_rad": -0.1, "mount_x_m": 0.2},
        {"mount_height_m": 1.1, "mount_pitch_rad": 0.35, "mount_x_m": -0.1},
    ],
    ids=["above", "below", "on a mast"],
)
def test_shows_what_the_policys_camera_sees_of_the_same_scene(
    place: dict[str, float], size: tuple[int, int], share: float
) -> None:
    camera = CameraConfig(*size, min_range_m=0.3, max_range_m=8.0, **place)
    mount, sent, wanted = CameraMount.of(camera), picture(camera), picture(POLICYS)
    drawn = reproject(image(sent), None, mount, POLICYS)
    common = seen_by_both(wanted, sent, camera)
    assert common.mean() > 0.5  # the rest is out of the other camera's view, hidden from it, or out of range
    inside = common & away_from_edges(wanted)
    assert inside.sum() > 0.6 * common.sum()
    error = np.where(np.isfinite(drawn), np.abs(drawn - wanted), np.inf)
    assert (error[inside] < 0.03).mean() > share
    assert np.median(error[inside]) < 0.002
    # Even along silhouettes most pixels show the right surface.
    assert (error[common] < 0.03).mean() > 0.93


@settings(max_examples=60, deadline=None)
@given(
    mount=st.builds(
        CameraMount,
        st.floats(0.2, 1.2),
        st.floats(-0.3, 0.3),
        st.floats(-0.3, 0.3),
        pitch_rad=st.floats(-0.3, 0.3),
        yaw_rad=st.floats(-0.3, 0.3),
        roll_rad=st.sampled_from([0.0, 0.1, math.pi / 2, math.pi]),
    ),
    pixel=st.tuples(st.integers(1, 98), st.integers(1, 72)),
    depth=st.floats(1.0, 6.0),
)
def test_a_point_lands_where_projection_by_matrices_says(
    mount: CameraMount, pixel: tuple[int, int], depth: float
) -> None:
    seen = Intrinsics(100, 74, 90.0, 85.0, 48.0, 40.0)
    depth_m = np.full((74, 100), np.nan, np.float32)
    u, v = pixel
    depth_m[v - 1 : v + 2, u - 1 : u + 2] = depth  # without depth around it, a pixel alone would be filled to this too
    drawn = reproject(image(depth_m), seen, mount, POLICYS)
    turn, place = matrices(mount)
    policys_turn, policys_place = matrices(CameraMount.of(POLICYS))
    ray = np.array([(u - seen.centre_x) / seen.focal_x, (v - seen.centre_y) / seen.focal_y, 1.0])
    right, down, ahead = policys_turn.T @ (place + turn @ (depth * ray) - policys_place)
    column = POLICYS.width / 2 - 0.5 + POLICYS.focal_px[0] * right / ahead
    row = POLICYS.height / 2 - 0.5 + POLICYS.focal_px[1] * down / ahead
    where = round(row), round(column)
    assume(0 <= where[0] < POLICYS.height and 0 <= where[1] < POLICYS.width)
    # Half a pixel from the point, on a surface that may be turned by a radian.
    assert drawn[where] == pytest.approx(ahead, abs=0.02 * ahead)
    rows, columns = np.nonzero(np.isfinite(drawn))
    assert max(np.abs(rows - row).max(), np.abs(columns - column).max()) < 4.5 * max(1.0, depth / ahead)


@pytest.mark.parametrize("policys", [POLICYS, CameraConfig(mount_height_m=0.5, mount_x_m=0.05, mount_pitch_rad=0.2)])
def test_a_wall_and_a_floor_are_exact_whatever_the_resolution(policys: CameraConfig) -> None:
    mount = CameraMount(0.9, 0.1, -0.2, pitch_rad=0.3, yaw_rad=0.15, roll_rad=0.1)
    turn, place = matrices(mount)
    policys_turn, policys_place = matrices(CameraMount.of(policys))

    def planes(turn: np.ndarray, place: np.ndarray, seen: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
        """Depths of a floor and of a wall 4 m ahead."""
        u, v = np.meshgrid(np.arange(seen.width), np.arange(seen.height))
        rays = np.stack([(u - seen.centre_x) / seen.focal_x, (v - seen.centre_y) / seen.focal_y, np.ones(u.shape)], -1)
        rays = rays @ turn.T
        with np.errstate(divide="ignore"):
            floor, wall = -place[2] / rays[..., 2], (4.0 - place[0]) / rays[..., 0]
        return np.where(floor > 0, floor, np.inf), np.where(wall > 0, wall, np.inf)

    view = Intrinsics(80, 60, *policys.focal_px, 39.5, 29.5)
    floor, wall = planes(policys_turn, policys_place, view)
    wanted = np.minimum(floor, wall)
    for width, height in ((96, 72), (211, 158), (640, 480), (1280, 960)):
        seen = Intrinsics(width, height, 0.9 * width, 0.9 * width, width / 2 - 0.5, height / 2 - 0.5)
        drawn = reproject(image(np.minimum(*planes(turn, place, seen))), seen, mount, policys)
        # Where floor and wall meet, a pixel may show either.
        plain = np.isfinite(drawn) & (np.abs(floor / wall - 1) > 0.2)
        assert plain.mean() > 0.4
        np.testing.assert_allclose(drawn[plain], wanted[plain], rtol=2e-3)


@pytest.mark.parametrize("side", [1, -1])
def test_a_thing_keeps_its_width_hides_what_is_behind_and_what_it_hid_stays_unknown(side: int) -> None:
    """A post .22 m wide at 2 m before a wall at 4 m, through a camera .3 m to the left or to the right."""
    seen = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)
    left = (seen.centre_x - np.arange(320)) / seen.focal_x
    row = np.where(np.abs(0.3 * side + 2.0 * left) <= 0.11, 2.0, 4.0)
    drawn = reproject(image(np.tile(row, (240, 1))), seen, CameraMount(0.4, 0.0, 0.3 * side), POLICYS)
    middle, toward = drawn[30], side * POLICYS.column_slopes
    post = np.abs(2.0 * toward) <= 0.11
    np.testing.assert_allclose(middle[post], 2.0, atol=1e-4)
    # On the post's other side that camera cannot see the wall from .08 to .52 m.
    hidden = (4.0 * toward < -0.08) & (4.0 * toward > -0.52) & ~post
    assert np.isnan(middle[hidden]).sum() >= hidden.sum() - 2 and hidden.sum() > 3
    others = ~post & ~hidden & np.isfinite(middle)
    assert others.sum() > 40
    np.testing.assert_allclose(middle[others], 4.0, atol=1e-3)


def test_pixels_without_depth_are_filled_from_around_and_no_farther() -> None:
    depth_m = np.full((480, 640), 3.0, np.float32)
    depth_m[::2, ::2] = np.nan  # single pixels, as noise takes them
    depth_m[:, 300:340] = np.nan  # a hole
    drawn = reproject(image(depth_m), None, CameraMount(0.45), POLICYS)
    holes = np.isnan(drawn[20])
    assert 3 <= holes.sum() <= 6 and (np.flatnonzero(holes) > 35).all() and (np.flatnonzero(holes) < 45).all()
    assert np.isfinite(drawn[10:50, :35]).all()
    assert np.isnan(reproject(image(np.full((30, 40), np.nan)), None, CameraMount(0.45), POLICYS)).all()


def test_what_is_behind_or_at_the_policys_camera_is_not_drawn() -> None:
    near = image(np.full((60, 80), 0.3))
    for mount in (CameraMount(0.4, -0.3), CameraMount(0.4, -0.8), CameraMount(0.4, yaw_rad=math.pi)):
        assert np.isnan(reproject(near, None, mount, POLICYS)).all()


def test_another_shape_than_the_camera_infos_is_refused() -> None:
    with pytest.raises(ValueError, match="camera_info's size"):
        reproject(image(np.ones((60, 60))), Intrinsics(640, 480, 500, 500, 320, 240), CameraMount(0.6), POLICYS)


@settings(max_examples=60, deadline=None)
@given(
    focal=st.floats(1.5, 1e300),
    centre=st.floats(-1e300, 1e300),
    depth=st.floats(1e-37, 1e37),
    yaw=st.floats(-math.pi, math.pi),
    size=st.tuples(st.integers(1, 40), st.integers(1, 40)),
)
def test_odd_intrinsics_and_depths_give_a_picture_all_the_same(
    focal: float, centre: float, depth: float, yaw: float, size: tuple[int, int]
) -> None:
    seen = Intrinsics(size[1], size[0], focal, focal, centre, 10.0)
    drawn = reproject(image(np.full(size, depth)), seen, CameraMount(0.5, yaw_rad=yaw), POLICYS)
    assert drawn.shape == (POLICYS.height, POLICYS.width)
    assert ((drawn > 0) | np.isnan(drawn)).all()
