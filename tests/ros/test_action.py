"""TF and Nav2's action over real ROS 2: where the scanner sits, goals in the map's frame, and every way in which a goal
ends. One node goes through all scenes of action_client.py; each test looks at one.

The messages that the wheels lack are built by ros2_messages.py; without a compiler the tests are skipped.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rosbags")
import middleware

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
"""action_msgs/GoalStatus."""
TF_ERROR = 9002
"""nav2_msgs/action/NavigateToPose."""
SCENES = [
    ("extrinsics", 5.0),
    ("rejected", 5.0),
    ("success", 15.0),
    ("cancel", 5.0),
    ("preempt", 5.0),
    ("unknown_frame", 6.0),
    ("lost", 6.0),
    ("stuck", 12.0),
    ("deactivated", 5.0),
    ("signal-interrupted", 3.0),
]


@pytest.fixture(scope="module")
def told(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    python = middleware.python_of("2")
    try:
        messages = middleware.build_messages(python)
    except FileNotFoundError as error:
        pytest.skip(f"nav2_msgs and tf2_msgs cannot be built: {error}")
    tmp = tmp_path_factory.mktemp("action")
    robot = tmp / "robot.yaml"
    robot.write_text("base_frame: base_footprint\n")  # no mount: the scanner's place comes from TF
    folder: Path = request.getfixturevalue("folder")  # only now: skipped tests need no export
    ros = middleware.ros2(python, folder, str(robot), tmp, messages)
    return ros.drive(SCENES, "action", program="action_client.py")


pytestmark = pytest.mark.timeout(300)  # the first test waits for all scenes


def test_the_scanners_place_comes_from_tf_static(told: dict[str, Any]) -> None:
    scene = told["extrinsics"]
    assert any("base_footprint -> laser" in reason for reason in scene["before"]), scene
    assert scene["after"] == "no goal yet", scene


def test_a_goal_in_the_map_is_reached_where_tf_puts_it(told: dict[str, Any]) -> None:
    scene = told["success"]
    assert scene["accepted"] and scene["status"] == SUCCEEDED, scene
    assert (scene["code"], scene["error"]) == (0, "")
    assert math.dist(scene["where"][:2], (2.5, 0.0)) < 0.5, scene["where"]
    assert scene["last"] == [0.0, 0.0]


def test_feedback_says_how_far_and_how_long(told: dict[str, Any]) -> None:
    scene = told["success"]
    distances, seconds, recoveries, frames = zip(*scene["feedback"], strict=True)
    assert len(distances) > 5 and set(frames) == {"odom"}
    assert distances[0] == pytest.approx(2.5, abs=0.3) and 0.25 < distances[-1] < 0.7
    assert all(later <= earlier + 0.05 for earlier, later in itertools.pairwise(distances))
    assert all(later > earlier for earlier, later in itertools.pairwise(seconds))
    assert seconds[-1] <= scene["took_s"] and set(recoveries) == {0}


def test_feedback_counts_the_escapes(told: dict[str, Any]) -> None:
    scene = told["stuck"]
    recoveries = [row[2] for row in scene["feedback"]]
    assert recoveries[0] == 0 and recoveries[-1] == 1 and scene["status"] == CANCELED, recoveries
    assert "frozen: turning towards the freest direction" in {reason for _, reason in told["reasons"]}


def test_a_goal_that_is_no_place_is_rejected(told: dict[str, Any]) -> None:
    assert told["rejected"]["accepted"] is False
    assert "goal rejected: goal is (nan, 0.0)" in told["node"]


def test_cancelling_stops_the_robot(told: dict[str, Any]) -> None:
    scene = told["cancel"]
    assert scene["driven"] and scene["status"] == CANCELED, scene
    assert scene["moving_s"] <= 0.6 and scene["answered_s"] <= 1.0, scene
    print(f"cancelled: zero after {1e3 * scene['moving_s']:.0f} ms, told after {1e3 * scene['answered_s']:.0f} ms")
    assert "goal cancelled" in {reason for _, reason in told["reasons"]}


def test_a_new_goal_takes_the_place_of_the_one_before(told: dict[str, Any]) -> None:
    scene = told["preempt"]
    assert scene["first"]["status"] == ABORTED and "another goal" in scene["first"]["error"], scene["first"]
    assert scene["early"]["accepted"] and scene["early"]["status"] is None and scene["driven"], scene["early"]
    # A goal on a topic is a new one too, and the robot drives to it.
    assert scene["second"]["status"] == ABORTED and "another goal" in scene["second"]["error"], scene["second"]
    assert scene["going_on"] and scene["third"]["status"] == CANCELED, scene


def test_a_goal_in_a_frame_that_nobody_knows_is_aborted_and_moves_nothing(told: dict[str, Any]) -> None:
    scene = told["unknown_frame"]
    assert (scene["status"], scene["code"]) == (ABORTED, TF_ERROR), scene
    assert scene["error"] == "goal lost: no transform odom -> moon: they are not connected"
    assert scene["moving_s"] == 0.0 and 1.5 < scene["seconds"] < 4.0


def test_without_tf_the_robot_waits_goes_on_and_at_last_gives_up(told: dict[str, Any]) -> None:
    scene = told["lost"]
    assert scene["paused"] and scene["resumed"], scene
    assert (scene["status"], scene["code"]) == (ABORTED, TF_ERROR), scene
    assert scene["error"].startswith("goal lost: transform map -> odom is "), scene["error"]
    assert scene["moving_s"] <= 0.8, scene


def test_deactivation_aborts_the_goal_and_activation_does_not_drive_to_it(told: dict[str, Any]) -> None:
    scene = told["deactivated"]
    assert scene["driven"] and scene["status"] == ABORTED and "stopped" in scene["error"], scene
    assert scene["moving_s"] <= 0.6 and scene["moving_again_s"] == 0.0, scene
    assert scene["inactive"]["accepted"] is False


def test_sigint_says_zero_and_tells_the_client(told: dict[str, Any]) -> None:
    scene = told["interrupted"]
    assert scene["driven"] and scene["moving_s"] <= 0.6 and scene["last"] == [0.0, 0.0], scene
    assert scene["status"] == ABORTED and "stopped" in scene["error"], scene
