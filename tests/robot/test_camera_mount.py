"""Where a depth camera sits, as parameters and as TF say it, and what the runtime makes of both."""

from __future__ import annotations

import itertools
import math
from types import SimpleNamespace as Message
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from densecavoid.frames import CameraConfig, SensorFrame
from densecavoid.robot.camera_mount import CameraMount
from densecavoid.robot.config import RobotSettings, read_yaml, settings_from
from densecavoid.robot.drivers import Drivers, header
from densecavoid.robot.faults import ScriptedPilot
from densecavoid.robot.messages import DepthResampler, Mount, depth_from_ros
from densecavoid.robot.reprojection import reproject
from densecavoid.robot.runtime import RobotRuntime
from densecavoid.robot.transforms import TransformTree
from densecavoid.robot.wire import MessageTypes, Outgoing

ANGLE = st.floats(-3.1, 3.1)


def quaternion(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """(x, y, z, w) of a URDF's rpy, as tf2's setRPY multiplies them."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a / 2), math.sin(a / 2)) for a in (roll, pitch, yaw))
    x, y = sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy
    return np.array([x, y, cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy])


def turned(rotation: np.ndarray, point: np.ndarray) -> np.ndarray:
    """A point turned by a quaternion, by the formula without a matrix."""
    axis, w = rotation[:3], rotation[3]
    twice = 2 * np.cross(axis, point)
    return point + w * twice + np.cross(axis, twice)


def transform(parent: str, child: str, place: tuple[float, ...], rpy: tuple[float, ...], stamp_s: float = 1.0) -> Any:
    x, y, z, w = (float(value) for value in quaternion(*rpy))
    translation = Message(x=place[0], y=place[1], z=place[2])
    inner = Message(translation=translation, rotation=Message(x=x, y=y, z=z, w=w))
    return Message(header=header(stamp_s, parent), child_frame_id=child, transform=inner)


OPTICAL = (-math.pi / 2, 0.0, -math.pi / 2)
"""rpy of an optical frame in its camera's link, as URDFs have it (REP-103)."""


def chain(*, link: str = "camera_link", optical: str = "camera_depth_optical_frame") -> list[Any]:
    """A robot's usual tree: the camera's link at x .1, y .05, height .6 m, looking 12 degrees down and 5 left."""
    return [
        transform("base_footprint", "base_link", (0.0, 0.0, 0.0102), (0.0, 0.0, 0.0)),
        transform("base_link", link, (0.1, 0.05, 0.5898), (0.0, math.radians(12), math.radians(5))),
        transform(f"/{link}", optical, (0.0, 0.0, 0.0), OPTICAL),
    ]


WANTED = CameraMount(0.6, 0.1, 0.05, pitch_rad=math.radians(12), yaw_rad=math.radians(5))


def check_same(mount: CameraMount, wanted: CameraMount) -> None:
    np.testing.assert_allclose(mount.pos_m, wanted.pos_m, atol=1e-9)
    np.testing.assert_allclose(mount.rotation, wanted.rotation, atol=1e-9)


@pytest.mark.parametrize("frame", ["camera_depth_optical_frame", "camera_link"])
def test_a_chain_of_transforms_gives_the_mount_that_parameters_give(frame: str) -> None:
    tree = TransformTree()
    assert tree.take(chain(), 0.0, static=True) == []
    mount = CameraMount.from_transform(tree.look_up_3d("base_footprint", frame, 0.0, 0.5), frame)
    check_same(mount, WANTED)
    assert mount.pitch_rad == pytest.approx(math.radians(12)) and mount.roll_rad == pytest.approx(0.0, abs=1e-9)


def test_optical_axes_are_known_by_name_or_by_how_they_lie() -> None:
    tree = TransformTree()
    tree.take(chain(link="mast", optical="depth_camera_link"), 0.0, static=True)  # so the Azure Kinect's driver
    for frame in ("mast", "depth_camera_link"):
        check_same(CameraMount.from_transform(tree.look_up_3d("base_footprint", frame, 0.0, 0.5), frame), WANTED)


@given(st.lists(st.tuples(*[st.floats(-2, 2)] * 3, *[ANGLE] * 3), min_size=3, max_size=3))
def test_whole_rotations_chain_as_points_are_carried(edges: list[tuple[float, ...]]) -> None:
    tree = TransformTree()
    names = ("a", "b", "c", "d")
    messages = [
        transform(*pair, edge[:3], edge[3:]) for pair, edge in zip(itertools.pairwise(names), edges, strict=True)
    ]
    assert tree.take(messages, 0.0, static=True) == []
    point = np.array([0.3, -0.7, 1.1])
    carried = point
    for edge in reversed(edges):
        carried = np.array(edge[:3]) + turned(quaternion(*edge[3:]), carried)
    np.testing.assert_allclose((tree.look_up_3d("a", "d", 0.0, 1.0) @ [*point, 1.0])[:3], carried, atol=1e-9)
    np.testing.assert_allclose((tree.look_up_3d("d", "a", 0.0, 1.0) @ [*carried, 1.0])[:3], point, atol=1e-9)


@given(ANGLE, st.floats(-1.5, 1.5), ANGLE)
def test_angles_are_a_urdfs(roll: float, pitch: float, yaw: float) -> None:
    mount = CameraMount(0.5, pitch_rad=pitch, yaw_rad=yaw, roll_rad=roll)
    for axis in np.eye(3):
        np.testing.assert_allclose(mount.rotation @ axis, turned(quaternion(roll, pitch, yaw), axis), atol=1e-12)
    assume(abs(mount.rotation[2, 2]) > 0.75)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = mount.rotation, mount.pos_m
    check_same(CameraMount.from_transform(matrix, "camera_link"), mount)


def test_the_pitch_is_that_of_a_simulated_camera() -> None:
    mount = CameraMount.of(CameraConfig(mount_height_m=0.6, mount_pitch_rad=0.2, mount_x_m=0.1))
    assert mount == CameraMount(0.6, 0.1, pitch_rad=0.2)
    np.testing.assert_allclose(mount.rotation[:, 0], [math.cos(0.2), 0.0, -math.sin(0.2)])  # it looks down
    assert CameraMount(0.6, yaw_rad=0.3).rotation[1, 0] > 0  # to the left
    assert CameraMount(0.6, roll_rad=0.3).rotation[2, 1] > 0  # its left side is raised


@pytest.mark.parametrize(
    ("moved", "same"),
    [
        ({"x_m": 0.009}, True),
        ({"x_m": 0.011}, False),
        ({"height_m": 0.412}, False),
        ({"y_m": -0.008, "height_m": 0.408}, False),
        ({"yaw_rad": math.radians(0.45)}, True),
        ({"roll_rad": -math.radians(0.55)}, False),
        ({"pitch_rad": math.radians(0.4), "yaw_rad": math.radians(0.4)}, False),
    ],
)
def test_a_centimetre_or_half_a_degree_is_another_place(moved: dict[str, float], same: bool) -> None:
    assert CameraMount(**({"height_m": 0.4} | moved)).is_as(CameraMount.of(CameraConfig())) is same


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("{}", "CameraMount.height_m is missing"),
        ("{height_m: -0.1}", "CameraMount.height_m is -0.1"),
        ("{height_m: .nan}", "CameraMount.height_m is nan"),
        ("{height_m: 0.5, x_m: 12}", "CameraMount.x_m is 12"),
        ("{height_m: 0.5, y_m: -.inf}", "CameraMount.y_m is -inf"),
        ("{height_m: 0.5, pitch_rad: 11.5}", "CameraMount.pitch_rad is 11.5"),
        ("{height_m: 0.5, yaw_rad: .nan}", "CameraMount.yaw_rad is nan"),
        ("{height_m: 0.5, roll_rad: -4}", "CameraMount.roll_rad is -4"),
        ("{height_m: 0.5, tilt: 1}", "no field 'tilt'"),
    ],
)
def test_wrong_mounts_are_refused_by_name(text: str, what: str) -> None:
    with pytest.raises(ValueError, match=what):
        settings_from(read_yaml(f"camera_mount: {text}", "robot.yaml"), "robot.yaml")


def test_a_mount_is_read_from_yaml() -> None:
    text = "camera_mount: {height_m: 0.6, x_m: 0.1, pitch_rad: 0.2}"
    assert settings_from(read_yaml(text, "robot.yaml"), "robot.yaml").camera_mount == CameraMount(
        0.6, 0.1, pitch_rad=0.2
    )


# -- in the loop -------------------------------------------------------------------------------------------------------

POLICYS = ScriptedPilot.camera


class Plain(Message):
    """Any ROS message as plain values."""

    header: Any = None


KINDS: dict[str, Any] = dict.fromkeys(MessageTypes.__dataclass_fields__, Plain) | {"level_of": int}
ELSEWHERE = CameraConfig(width=160, height=120, mount_height_m=0.6)


def send(runtime: RobotRuntime, frame: str, stamp_s: float) -> tuple[Any, np.ndarray]:
    """A wall 2 to 3 m ahead through a camera; the message, and what the loop keeps of it."""
    depth = np.linspace(2.0, 3.0, ELSEWHERE.width, dtype=np.float32) * np.ones((ELSEWHERE.height, 1), np.float32)
    sensed = SensorFrame(
        time_s=np.zeros(1),
        scan_m=np.full((1, 2), np.inf, np.float32),
        depth_m=depth[None],
        odom_pose=np.zeros((1, 3)),
        velocity=np.zeros((1, 2), np.float32),
        goal_odom=np.zeros((1, 2)),
    )
    message = Drivers(ScriptedPilot.lidar, ELSEWHERE).depth(sensed, stamp_s)
    message.header.frame_id = frame
    assert runtime.on_depth(message, stamp_s, stamp_s) == ""
    runtime.on_odom(Drivers(ScriptedPilot.lidar, ELSEWHERE).odom(sensed, stamp_s), stamp_s, stamp_s)
    kept = runtime.sensed(stamp_s)
    assert kept is not None
    return message, kept.depth_m[0]


def test_the_loop_reprojects_by_its_settings_and_by_tf_alike() -> None:
    by_settings = RobotRuntime(
        ScriptedPilot(), RobotSettings(lidar_mount=Mount(), camera_mount=WANTED, use_tf=False), threaded=False
    )
    by_tf = RobotRuntime(ScriptedPilot(), RobotSettings(lidar_mount=Mount()), threaded=False)
    frame = "camera_depth_optical_frame"
    message, before = send(by_tf, frame, 1.0)
    plain = DepthResampler(POLICYS)(depth_from_ros(message), None)
    np.testing.assert_array_equal(before, plain)  # as long as TF does not know it: the policy's own place
    assert "taken for the policy's" in by_tf.camera_place and "not connected" in by_tf.camera_place
    by_tf.on_transforms(chain(), 1.0, static=True)
    message, from_settings = send(by_settings, frame, 2.0)
    _, from_tf = send(by_tf, frame, 2.0)
    np.testing.assert_allclose(from_tf, from_settings, atol=1e-5)
    np.testing.assert_array_equal(from_settings, reproject(depth_from_ros(message), None, WANTED, POLICYS))
    assert not np.array_equal(from_settings, plain, equal_nan=True)
    assert "(settings), reprojected" in by_settings.camera_place and "(TF), reprojected" in by_tf.camera_place
    status = (
        Outgoing(MessageTypes(**KINDS), False, lambda header: None)
        .diagnostics(by_tf, by_tf.step(2.0, 2.0), 2.0)
        .status[0]
    )
    assert {pair.key: pair.value for pair in status.values}["camera's place"] == by_tf.camera_place


@pytest.mark.parametrize(
    "changes",
    [{"use_tf": False}, {"camera_mount": CameraMount(0.405)}, {"use_tf": False, "camera_mount": CameraMount(0.4)}],
)
def test_a_camera_in_the_policys_place_shows_its_image_bit_for_bit(changes: dict[str, Any]) -> None:
    runtime = RobotRuntime(ScriptedPilot(), RobotSettings(lidar_mount=Mount(), **changes), threaded=False)
    message, kept = send(runtime, "camera", 1.0)
    np.testing.assert_array_equal(kept, DepthResampler(POLICYS)(depth_from_ros(message), None))


def test_a_camera_that_looks_away_is_said_to_see_nothing_of_the_view() -> None:
    away = RobotSettings(lidar_mount=Mount(), camera_mount=CameraMount(0.4, yaw_rad=math.pi))
    runtime = RobotRuntime(ScriptedPilot(), away, threaded=False)
    with pytest.raises(AssertionError, match="mounted so"):
        send(runtime, "camera", 1.0)
