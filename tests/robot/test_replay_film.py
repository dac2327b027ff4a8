"""Films of recordings: as long as the recording, and people where the loop says that they are."""

from __future__ import annotations

import json
import math
import subprocess
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image, ImageSequence

pytest.importorskip("rosbags")
from recordings import Kind, drive, write_recording

from densecavoid.frames import SensorFrame
from densecavoid.robot.replay import ReplayConfig
from densecavoid.viz import theme
from densecavoid.viz.replay_film import film_replay
from densecavoid.viz.sinks import Mp4Sink

SECONDS = 3.0
SCENE = (20, 54, 446, 446)
"""Left, top, width and height of the picture from above, and its scale, .3 m beyond the lidar's 4 m."""
PIXELS_PER_M = 446 / 8.6


@pytest.fixture(scope="module")
def frames() -> list[SensorFrame]:
    return drive(SECONDS)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("robot") / "robot.yaml"
    path.write_text("use_tf: false\n")
    return str(path)


def pictures_of(path: Path) -> list[np.ndarray]:
    """All of a film's, [rows, columns, 3]."""
    assert next(imageio_ffmpeg.read_frames(str(path)))["size"] == (900, 520)
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", path, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(command, capture_output=True, check=True).stdout
    return list(np.frombuffer(raw, np.uint8).reshape(-1, 520, 900, 3).astype(int))


def near(picture: np.ndarray, colour: theme.Colour, by: int) -> np.ndarray:
    return np.abs(picture - colour).sum(axis=-1) < by


@pytest.mark.parametrize("kind", [".bag", ".mcap", ".db3"])
def test_a_film_has_a_picture_each_tenth_of_a_second_of_every_kind_of_recording(
    kind: Kind, frames: list[SensorFrame], robot: str, tmp_path: Path
) -> None:
    bag = write_recording(tmp_path / "drive", kind, frames)
    summary = film_replay(ReplayConfig(bag, robot=robot, out=tmp_path / "out"))
    assert summary.scans == len(frames) and summary.unreadable == 0 and summary.people_most > 0
    pictures = pictures_of(tmp_path / "out" / "replay.mp4")
    assert len(pictures) == len(frames) == math.ceil(summary.commands / 2)
    rows = [json.loads(line) for line in (tmp_path / "out" / "commands.jsonl").read_text().splitlines()]
    left, top, width, height = SCENE
    checked = 0
    for picture, row, frame in zip(pictures[1:], rows[2::2], frames[1:], strict=True):
        # Returns of the lidar, the robot in the middle, and in the depth image more than one colour.
        assert near(picture[top : top + height, left : left + width], theme.LIDAR, 150).sum() > 20
        assert near(picture[top + 213 : top + 233, left + 213 : left + 233], theme.ROBOT, 150).sum() > 40
        assert picture[80:190, 500:670].std() > 10
        yaw = frame.odom_pose[0, 2]
        for x, y, *_ in row["people"]:
            # Ahead and left of the robot, which stands in the middle: right and up on the picture.
            ahead = x * math.cos(yaw) - y * math.sin(yaw), x * math.sin(yaw) + y * math.cos(yaw)
            column, line = 223 + PIXELS_PER_M * ahead[0], 223 - PIXELS_PER_M * ahead[1]
            if min(column, line) < 20 or max(column, line) > 425:
                continue
            around = picture[top + round(line) - 9 : top + round(line) + 10, left + round(column) - 9 :][:, :19]
            orange = (around[..., 0] > 180) & (around[..., 2] < 175) & (around[..., 0] - around[..., 2] > 60)
            assert orange.mean() > 0.5, (row["time_s"], x, y)
            checked += 1
    assert checked > 20


def test_without_a_camera_the_scan_is_shown_and_without_a_film_there_is_none(
    frames: list[SensorFrame], robot: str, tmp_path: Path
) -> None:
    bag = write_recording(tmp_path / "drive", ".mcap", frames[:10], camera=False)
    film_replay(ReplayConfig(bag, robot=robot, out=tmp_path / "out", film="gif"))
    with Image.open(tmp_path / "out" / "replay.gif") as film:
        picture = [np.asarray(frame.convert("RGB")).astype(int) for frame in ImageSequence.Iterator(film)][-1]
    fan = picture[70:204, 494:672]
    assert near(fan, theme.LIDAR, 90).sum() > 20 and near(fan, theme.FREE_SPACE, 40).mean() > 0.1
    film_replay(ReplayConfig(bag, robot=robot, out=tmp_path / "quiet", film="none"))
    assert sorted(path.name for path in (tmp_path / "quiet").iterdir()) == [
        "commands.jsonl",
        "exported",
        "summary.json",
    ]


def test_a_film_that_cannot_be_finished_leaves_no_file(
    frames: list[SensorFrame], robot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(sink: Mp4Sink, hold_s: float) -> None:
        raise OSError("no space left")

    bag = write_recording(tmp_path / "drive", ".bag", frames[:5])
    monkeypatch.setattr(Mp4Sink, "close", fail)
    with pytest.raises(OSError, match="no space left"):
        film_replay(ReplayConfig(bag, robot=robot, out=tmp_path / "out"))
    assert not (tmp_path / "out" / "replay.mp4").exists()
