"""ROS messages become the policy's sensors: compared with rays by hand, and sizes and encodings with one another."""

from __future__ import annotations

import contextlib
import math
from types import SimpleNamespace as Message
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from densecavoid.frames import CameraConfig, LidarConfig
from densecavoid.robot.messages import (
    DepthResampler,
    Intrinsics,
    Mount,
    clean_ranges,
    depth_from_ros,
    goal_from_ros,
    intrinsics_from_ros,
    odometry_from_ros,
    resample_scan,
    scan_from_ros,
    scan_in_robot,
    stamp_of,
)

HEADER = Message(stamp=Message(sec=3, nanosec=500_000_000), frame_id="laser")


def scan_message(ranges: Any, angle_min: float = -2.0, increment: float | None = None, **changes: Any) -> Message:
    count = max(len(ranges) - 1, 1)
    fields = {
        "header": HEADER,
        "angle_min": angle_min,
        "angle_increment": -2 * angle_min / count if increment is None else increment,
        "range_min": 0.1,
        "range_max": 8.0,
        "ranges": ranges,
    }
    return Message(**(fields | changes))


def image_message(image: np.ndarray, encoding: str, big: bool = False, pad: int = 0) -> Message:
    rows = [row.astype(image.dtype.newbyteorder(">" if big else "<")).tobytes() + bytes(pad) for row in image]
    height, width = image.shape
    step = width * image.dtype.itemsize + pad
    return Message(
        header=HEADER, encoding=encoding, width=width, height=height, step=step, is_bigendian=big, data=b"".join(rows)
    )


def test_stamps_of_both_ros_versions() -> None:
    assert stamp_of(HEADER) == 3.5
    assert stamp_of(Message(stamp=Message(secs=3, nsecs=500_000_000))) == 3.5


def test_ranges_by_rep_117() -> None:
    scan = scan_from_ros(scan_message([np.inf, -np.inf, np.nan, 0.05, 2.0, 9.0, 0.0, -1.0]))
    expected = [np.inf, 0.1, np.nan, 0.1, 2.0, np.inf, np.nan, np.nan]
    np.testing.assert_array_equal(clean_ranges(scan), expected)
    assert clean_ranges(scan, "nothing")[6] == np.inf
    np.testing.assert_array_equal(clean_ranges(scan, ignore_within_m=0.5)[:5], [np.inf, np.inf, np.nan, np.inf, 2.0])


LIDAR = LidarConfig(num_rays=129, fov_rad=math.radians(240), max_range_m=4.0)


def room(angles: np.ndarray, at: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Ranges from a place in a box of 6 x 4 m about the origin."""
    angles = angles + 1e-12  # no ray along a wall
    with np.errstate(divide="ignore"):
        x = np.where(np.cos(angles) > 0, (3 - at[0]) / np.cos(angles), (-3 - at[0]) / np.cos(angles))
        y = np.where(np.sin(angles) > 0, (2 - at[1]) / np.sin(angles), (-2 - at[1]) / np.sin(angles))
    return np.minimum(x, y)


@pytest.mark.parametrize(("count", "fov"), [(129, 240), (720, 270), (181, 250), (1081, 270), (360, 359)])
def test_scans_of_any_fov_and_count_become_the_policys(count: int, fov: float) -> None:
    half = math.radians(fov) / 2
    ranges = room(np.linspace(-half, half, count))
    scan = scan_from_ros(scan_message(ranges, -half))
    out, seen = resample_scan(scan, clean_ranges(scan), Mount(), LIDAR)
    truth = room(LIDAR.angles_rad)
    assert seen.all()
    # The nearest return of a sector: at most what the wall changes over a sector and a half.
    near = truth < 3.9
    spacing = max(LIDAR.fov_rad / 128, 2 * half / (count - 1))
    assert np.abs(out[near] - truth[near]).max() < 4.5 * spacing
    assert np.isinf(out[truth > 4.2]).all()


def test_where_nobody_looks_is_told() -> None:
    scan = scan_from_ros(scan_message(np.full(181, 2.0), -math.pi / 4))
    _, seen = resample_scan(scan, clean_ranges(scan), Mount(), LIDAR)
    np.testing.assert_array_equal(seen, np.abs(LIDAR.angles_rad) <= math.pi / 4 + LIDAR.fov_rad / 128 / 2)
    ranges = np.full(181, 2.0)
    ranges[60:120] = np.nan
    scan = scan_from_ros(scan_message(ranges))
    blind = ~resample_scan(scan, clean_ranges(scan), Mount(), LIDAR)[1] & (np.abs(LIDAR.angles_rad) < 1.9)
    assert blind.sum() == pytest.approx(60 * (4.0 / 180) / (LIDAR.fov_rad / 128), abs=2)


def test_a_scanner_that_is_shifted_turned_and_upside_down_sees_the_same_room() -> None:
    mount = Mount(-0.2, 0.1, math.radians(90), upside_down=True)
    angles = np.linspace(-math.pi, math.pi, 1441)[:-1]
    ranges = room(mount.yaw_rad - angles, (mount.x_m, mount.y_m))
    scan = scan_from_ros(scan_message(ranges, -math.pi, 2 * math.pi / 1440))
    ends, _ = scan_in_robot(scan, clean_ranges(scan), mount)
    np.testing.assert_allclose(np.minimum(3 - np.abs(ends[:, 0]), 2 - np.abs(ends[:, 1])), 0.0, atol=1e-9)
    out, seen = resample_scan(scan, clean_ranges(scan), mount, LIDAR)
    truth = room(LIDAR.angles_rad)
    near = truth < 3.9
    assert seen.all() and np.abs(out[near] - truth[near]).max() < 0.08


CAMERA = CameraConfig(width=20, height=15)


def test_depth_of_any_encoding_endianness_and_step_is_the_same() -> None:
    rng = np.random.default_rng(0)
    millimetres = rng.integers(0, 5000, (30, 40)).astype(np.uint16)
    metres = np.where(millimetres == 0, np.nan, millimetres / 1000).astype(np.float32)
    for big in (False, True):
        for pad in (0, 6):
            from_mm = depth_from_ros(image_message(millimetres, "16UC1", big, pad)).depth_m
            from_m = depth_from_ros(image_message(metres, "32FC1", big, pad)).depth_m
            np.testing.assert_allclose(from_mm, metres, atol=1e-6)
            np.testing.assert_array_equal(from_m, metres)


@pytest.mark.parametrize("size", [(15, 20), (60, 80), (480, 640), (99, 131)])
def test_depth_images_of_any_size_show_the_policy_the_same(size: tuple[int, int]) -> None:
    """A slanted plane: depth is 1 / (a + b u + c v) in a camera's slopes, whatever its pixels."""

    def plane(camera: CameraConfig) -> np.ndarray:
        return 1 / (0.4 + 0.1 * camera.column_slopes[None] + 0.2 * camera.row_slopes[:, None])

    camera = CameraConfig(width=size[1], height=size[0])
    image = depth_from_ros(image_message(plane(camera).astype(np.float32), "32FC1"))
    out = DepthResampler(CAMERA)(image, None)
    half_pixel = 0.5 * max(1 / camera.focal_px[0], 1 / camera.focal_px[1])
    np.testing.assert_allclose(1 / out, 1 / plane(CAMERA), atol=0.31 * half_pixel)
    intrinsics = Intrinsics(size[1], size[0], *camera.focal_px, size[1] / 2 - 0.5, size[0] / 2 - 0.5)
    np.testing.assert_array_equal(DepthResampler(CAMERA)(image, intrinsics), out)


def test_a_narrower_camera_leaves_the_rest_without_depth_and_holes_are_filled_from_around() -> None:
    narrow = CameraConfig(width=64, height=48, fov_horizontal_rad=math.radians(30), fov_vertical_rad=math.radians(24))
    image = np.full((48, 64), 2.0, np.float32)
    image[::2, ::2] = np.nan
    intrinsics = Intrinsics(64, 48, *narrow.focal_px, 31.5, 23.5)
    out = DepthResampler(CAMERA)(depth_from_ros(image_message(image, "32FC1")), intrinsics)
    inside = (np.abs(CAMERA.row_slopes) < math.tan(math.radians(12)))[:, None] & (
        np.abs(CAMERA.column_slopes) < math.tan(math.radians(15))
    )
    np.testing.assert_array_equal(np.isfinite(out), inside)


def test_odometry_and_goals() -> None:
    turn = Message(x=0.0, y=0.0, z=math.sin(0.35), w=math.cos(0.35))
    pose = Message(position=Message(x=1.0, y=2.0, z=0.0), orientation=turn)
    twist = Message(linear=Message(x=0.3), angular=Message(z=-0.1))
    message = Message(header=HEADER, child_frame_id="b", pose=Message(pose=pose), twist=Message(twist=twist))
    odometry = odometry_from_ros(message)
    np.testing.assert_allclose(odometry.pose, (1.0, 2.0, 0.7))
    assert odometry.velocity == (0.3, -0.1)
    assert goal_from_ros(Message(header=HEADER, pose=pose)).pos == (1.0, 2.0)
    turn.w = 5.0
    with pytest.raises(ValueError, match="quaternion"):
        odometry_from_ros(message)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"ranges": [1.0]}, "number of ranges"),
        ({"angle_increment": 0.0}, "field of view"),
        ({"angle_increment": 1.0}, "field of view"),
        ({"angle_min": math.nan}, "angles and limits"),
        ({"range_max": 0.05}, "range_min and range_max"),
    ],
)
def test_malformed_scans_are_refused_by_name(change: dict[str, Any], what: str) -> None:
    with pytest.raises(ValueError, match=what):
        scan_from_ros(Message(**(vars(scan_message(np.ones(10))) | change)))


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"encoding": "rgb8"}, "encoding"),
        ({"width": 0}, "size"),
        ({"width": 10**6, "height": 10**6, "step": 10**7}, "at most"),
        ({"step": 3}, "step"),
        ({"data": bytes(7)}, "bytes"),
    ],
)
def test_malformed_images_are_refused_by_name_before_memory_is_taken(change: dict[str, Any], what: str) -> None:
    message = image_message(np.ones((4, 6), np.uint16), "16UC1")
    vars(message).update(change)
    with pytest.raises(ValueError, match=what):
        depth_from_ros(message)


ANYTHING = st.one_of(
    st.none(), st.integers(-(2**70), 2**70), st.floats(), st.text(max_size=5), st.binary(max_size=40), st.just([])
)
READERS = {
    depth_from_ros: ("encoding", "width", "height", "step", "is_bigendian", "data"),
    scan_from_ros: ("angle_min", "angle_increment", "range_min", "range_max", "ranges"),
    intrinsics_from_ros: ("width", "height", "k"),
}


@settings(max_examples=300, deadline=None)
@given(reader=st.sampled_from(sorted(READERS, key=str)), data=st.data())
def test_readers_raise_nothing_but_what_the_runtime_catches(reader: Any, data: st.DataObject) -> None:
    from densecavoid.robot.runtime import MALFORMED

    good: dict[str, Any] = {"encoding": "16UC1", "width": 4, "height": 2, "step": 8, "is_bigendian": 0}
    good |= {"data": bytes(16), "k": [50.0, 0, 2, 0, 50.0, 1, 0, 0, 1]} | vars(scan_message([1.0] * 4))
    values = {name: data.draw(st.one_of(st.just(good[name]), ANYTHING)) for name in READERS[reader]}
    message = Message(header=HEADER, **values)
    with contextlib.suppress(*MALFORMED):
        reader(message)
