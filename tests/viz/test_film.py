"""Films and pictures of real episodes: they open, last as long as the episode, and leave nothing when given up."""

from __future__ import annotations

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image, ImageSequence

from densecavoid.baselines import GoToGoal
from densecavoid.benchmark.rollout import run_episodes
from densecavoid.frames import CameraConfig, LidarConfig
from densecavoid.scenarios import make_scenario
from densecavoid.sim.world import Simulator
from densecavoid.viz import theme
from densecavoid.viz.film import Film, FilmConfig, film_episode, seen_area
from densecavoid.viz.pictures import save_episode_picture
from densecavoid.viz.sinks import GifSink


def simulator(scenario: str = "random-goal") -> Simulator:
    return Simulator(make_scenario(scenario), 1)


def frames_of(path) -> tuple[list[Image.Image], list[int]]:
    """Pictures of a GIF, and how many milliseconds each is shown."""
    with Image.open(path) as film:
        frames = [(frame.convert("RGB"), int(frame.info["duration"])) for frame in ImageSequence.Iterator(film)]
    return [picture for picture, _ in frames], [duration for _, duration in frames]


@pytest.fixture(scope="module")
def gif(tmp_path_factory):
    """A filmed episode among people."""
    path = tmp_path_factory.mktemp("film") / "made" / "run.gif"
    return path, film_episode(simulator("random-sparse-ped"), GoToGoal(), 3, path)


def test_gif_has_a_frame_a_control_step_and_plays_in_real_time(gif):
    path, episode = gif
    pictures, durations_ms = frames_of(path)
    assert pictures[0].size == (900, 520)
    # Frames that show nothing new are merged into one that lasts longer.
    assert len(durations_ms) <= len(episode.time_s)
    assert sum(durations_ms) == pytest.approx(1000 * episode.duration_s + 1500, abs=1)
    assert durations_ms[-1] >= 1500


def test_gif_is_small_enough_to_be_shown(gif):
    path, episode = gif
    assert path.stat().st_size < 20_000 * len(episode.time_s) + 50_000


def test_last_picture_says_how_the_episode_ended(gif):
    path, episode = gif
    pictures, _ = frames_of(path)

    def shows_outcome(picture: Image.Image) -> bool:
        title = np.asarray(picture.crop((400, 0, 900, 46))).astype(int)
        return bool((np.abs(title - theme.OUTCOME[episode.outcome]).sum(axis=-1) < 30).sum() > 500)

    assert shows_outcome(pictures[-1])
    assert not shows_outcome(pictures[0])


def test_picture_moves_from_frame_to_frame(gif):
    pictures, _ = frames_of(gif[0])
    scene = (12, 46, 474, 508)
    early, late = (np.asarray(pictures[k].crop(scene)).astype(int) for k in (1, len(pictures) // 2))
    changed = (np.abs(early - late).sum(axis=-1) > 30).mean()
    assert 0.002 < changed < 0.5


def test_filming_changes_nothing(gif):
    _, filmed = gif
    (plain,) = run_episodes(simulator("random-sparse-ped"), GoToGoal(), [3])
    np.testing.assert_array_equal(plain.pose_w, filmed.pose_w)


def test_mp4_has_a_frame_a_control_step_and_holds_the_last(tmp_path):
    path = tmp_path / "run.mp4"
    episode = film_episode(simulator(), GoToGoal(), 3, path, FilmConfig(width_px=640, height_px=400, hold_s=1.0))
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert frames is not None and frames == len(episode.time_s) + 10
    assert seconds == pytest.approx(frames * 0.1, abs=0.11)
    assert next(imageio_ffmpeg.read_frames(str(path)))["size"] == (640, 400)


def test_a_long_gif_keeps_its_time_with_fewer_frames(tmp_path, monkeypatch):
    monkeypatch.setattr("densecavoid.viz.sinks.GIF_MAX_FRAMES", 10)
    sink = GifSink(tmp_path / "long.gif", 0.1)
    for k in range(37):
        sink.add(Image.new("RGB", (40, 20), [theme.PERSON, theme.ROBOT, theme.GOAL][k % 3]))
    sink.close(hold_s=1.0)
    pictures, durations_ms = frames_of(tmp_path / "long.gif")
    assert len(pictures) <= 12
    assert sum(durations_ms) == pytest.approx(3600 + 1000, abs=400)


def test_a_film_that_is_given_up_leaves_no_file(tmp_path):
    class Breaks(GoToGoal):
        def act(self, frame):
            if frame.time_s[0] > 0.25:
                raise RuntimeError("out of order")
            return super().act(frame)

    for name in ("run.gif", "run.mp4"):
        with pytest.raises(RuntimeError, match="out of order"):
            film_episode(simulator(), Breaks(), 1, tmp_path / name)
        assert not (tmp_path / name).exists()


def test_another_kind_of_file_is_refused_by_name(tmp_path):
    with pytest.raises(ValueError, match=r"'\.webm'.*\.gif, \.mp4"):
        Film(tmp_path / "run.webm", GoToGoal())
    with pytest.raises(ValueError, match=r"FilmConfig\.width_px is 901"):
        FilmConfig(width_px=901)


@pytest.mark.parametrize("scenario", ["dense-static", "dense-ped"])
def test_picture_of_an_episode_shows_the_path(scenario: str, tmp_path):
    (episode,) = run_episodes(simulator(scenario), GoToGoal(), [2], keep_people=True)
    path = tmp_path / "made" / "run.png"
    save_episode_picture(path, episode)
    with Image.open(path) as image:
        picture = np.asarray(image.convert("RGB")).astype(int)
    begins = theme.scale("plasma")[3].astype(int)
    assert (np.abs(picture - begins).sum(axis=-1) < 40).sum() > 10
    assert (np.abs(picture - theme.GOAL).sum(axis=-1) < 10).sum() > 10


def test_seen_area_ends_at_what_the_camera_sees_and_where_it_is_too_near():
    camera = CameraConfig()
    sim = simulator()
    sim.reset(np.array([1]))
    frame = sim.sense()
    frame.scan_m[:] = np.inf
    frame.depth_m[:] = np.nan
    pose = np.array([1.0, 2.0, np.pi / 2])
    frame.depth_m[0, 30, :20] = 3.0
    frame.scan_m[0, np.abs(LidarConfig().angles_rad + 0.2) < 0.15] = 0.8
    outline = seen_area(frame, camera, LidarConfig(), pose) - pose[:2]
    near, far = outline[:80, 1], outline[80:, 1][::-1]
    np.testing.assert_allclose(near, 1.4)
    np.testing.assert_allclose(far[:20], 3.0)
    np.testing.assert_allclose(far[25:38], 5.0)
    bearings = np.arctan(camera.column_slopes)
    np.testing.assert_allclose(far[np.abs(bearings + 0.2) < 0.1], 1.4)
    # The leftmost column looks to the left of a robot that looks along y: to -x.
    assert outline[0, 0] < 0 < outline[79, 0]
