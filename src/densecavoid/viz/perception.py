"""Pictures of perception: tracks and predictions from above, and a detector's errors by distance and density."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Ellipse, Wedge

from densecavoid.frames import seen_from
from densecavoid.perception.evaluation.driving import drive_about
from densecavoid.perception.evaluation.error_fit import ErrorTable
from densecavoid.perception.pipeline import PeoplePipeline, expect_people
from densecavoid.perception.predictor.calibration import INSIDE_HALF
from densecavoid.perception.tracks import HISTORY
from densecavoid.scenarios import make_scenario
from densecavoid.sim.world import SimConfig, Simulator
from densecavoid.viz import theme

_AHEAD_M, _BEHIND_M, _ASIDE_M = 6.0, 1.5, 4.0


def _colour(rgb: theme.Colour) -> tuple[float, float, float]:
    red, green, blue = (channel / 255 for channel in rgb)
    return red, green, blue


@dataclass(frozen=True)
class _Seen:
    """One world at one instant, everything in the robot's frame."""

    people: np.ndarray  # [P, 3] x, y, radius
    tracks: np.ndarray  # [T, 2]
    histories: list[np.ndarray]
    expected: np.ndarray  # [T, H, 2]
    covariance: np.ndarray  # [T, H, 3]
    depth_m: np.ndarray
    prediction: np.ndarray


def _look(pipeline: PeoplePipeline, scenario: str, steps: int, seed: int) -> _Seen:
    """The moment in which most people are followed in the camera's view."""
    config = pipeline.config
    sim = Simulator(
        make_scenario(scenario), 1, SimConfig(lidar=config.lidar, camera=config.camera, sensors="real", threads=1)
    )
    which = np.ones(1, np.bool_)
    slope = np.tan(config.camera.fov_horizontal_rad / 2)
    seen: _Seen | None = None
    most = -1
    for frame, _, fresh in drive_about(sim, steps, seed):
        pipeline.reset(fresh)
        pipeline.update(frame, which)
        truth, tracks, pose = frame.truth, pipeline.tracks, frame.odom_pose[0]
        assert truth is not None
        active = truth.people.active[0]
        places = seen_from(truth.robot_pose_w[0], truth.people.pos_w[0, active].astype(float))
        expected = expect_people(tracks, pipeline.predictor, config.horizons_s, which)
        sure = np.flatnonzero(tracks.confirmed[0])
        count = tracks.history_count[0]
        ahead, left = seen_from(pose, tracks.state[0, sure, :2]).T
        in_view = int(((ahead > config.camera.min_range_m) & (np.abs(left) < slope * ahead)).sum())
        if in_view <= most:
            continue
        most = in_view
        turn = _turned(expected.covariance, -float(pose[2]))
        seen = _Seen(
            np.column_stack([places, truth.people.radius_m[0, active]]),
            seen_from(pose, tracks.state[0, sure, :2]),
            [seen_from(pose, tracks.history[0, t, HISTORY - count[t] :].astype(float)) for t in sure],
            seen_from(pose, expected.pos.reshape(-1, 2)).reshape(expected.pos.shape),
            turn,
            frame.depth_m[0].copy(),
            pipeline.prediction[0].copy(),
        )
    assert seen is not None
    return seen


def _turned(covariance: np.ndarray, angle: float) -> np.ndarray:
    """Covariances [..., 3] (xx, xy, yy) of what is turned by `angle`."""
    cos, sin = np.cos(angle), np.sin(angle)
    xx, xy, yy = np.moveaxis(covariance, -1, 0)
    return np.stack(
        [
            cos**2 * xx - 2 * cos * sin * xy + sin**2 * yy,
            cos * sin * (xx - yy) + (cos**2 - sin**2) * xy,
            sin**2 * xx + 2 * cos * sin * xy + cos**2 * yy,
        ],
        axis=-1,
    )


def tracks_from_above(
    path: Path, pipeline: PeoplePipeline, scenarios: Sequence[str], steps: int = 40, seed: int = 0
) -> None:
    """One column a scenario: who is where, is followed, is expected where; the depth image; the prediction frame.

    Args:
        path: of the picture (.png).
        pipeline: of one world.
        scenarios: their names.
        steps: control steps of which the most telling one is drawn.
        seed: of the worlds.
    """
    figure = Figure((4.2 * len(scenarios), 9.0), facecolor=_colour(theme.PAGE), layout="constrained")
    figure.suptitle("people orange, their tracks black, where they are expected red (half of the time within)")
    axes = figure.subplots(3, len(scenarios), squeeze=False, height_ratios=(2.0, 1.0, 1.0))
    for column, scenario in enumerate(scenarios):
        seen = _look(pipeline, scenario, steps, seed + column)
        plan, image, frame = axes[:, column]
        plan.set_title(scenario, color=_colour(theme.INK))
        _draw_plan(plan, seen, pipeline)
        near, far = pipeline.config.camera.min_range_m, pipeline.config.camera.max_range_m
        image.imshow(theme.depth_colours((far - seen.depth_m) / (far - near)), interpolation="nearest")
        frame.imshow(seen.prediction, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        image.set_xlabel("depth image")
        horizons = ", ".join(f"{horizon:g}" for horizon in pipeline.config.horizons_s)
        frame.set_xlabel(f"prediction frame, {horizons} s ahead")
        for axis in (image, frame):
            axis.set_xticks([])
            axis.set_yticks([])
    figure.savefig(path, dpi=90)


def _draw_plan(axis: Axes, seen: _Seen, pipeline: PeoplePipeline) -> None:
    """The robot at the origin looks up; left is left."""
    camera = pipeline.config.camera
    half = np.degrees(camera.fov_horizontal_rad / 2)
    view = Wedge((0, 0), camera.max_range_m, 90 - half, 90 + half, width=camera.max_range_m - camera.min_range_m)
    view.set(facecolor=_colour(theme.FREE_SPACE), edgecolor="none")
    axis.add_patch(view)
    for x, y, radius in seen.people:
        axis.add_patch(Circle((-y, x), radius, facecolor=_colour(theme.PERSON), alpha=0.45, linewidth=0))
    for track, history in zip(seen.tracks, seen.histories, strict=True):
        axis.plot(-history[:, 1], history[:, 0], color=_colour(theme.INK), linewidth=1)
        axis.plot(-track[1], track[0], "o", color=_colour(theme.INK), markersize=4)
    for pos, covariance in zip(seen.expected, seen.covariance, strict=True):
        for (x, y), (xx, xy, yy) in zip(pos, covariance, strict=True):
            size, axes = np.linalg.eigh([[yy, -xy], [-xy, xx]])
            angle = np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))
            width, height = 2 * np.sqrt(INSIDE_HALF * np.maximum(size[::-1], 0.0))
            ellipse = Ellipse((-y, x), width, height, angle=angle)
            ellipse.set(facecolor="none", edgecolor=_colour(theme.LIDAR), linewidth=1.2)
            axis.add_patch(ellipse)
    axis.add_patch(Circle((0, 0), 0.18, facecolor=_colour(theme.ROBOT)))
    axis.plot([0, 0], [0, 0.4], color=_colour(theme.ROBOT), linewidth=2)
    axis.set(xlim=(-_ASIDE_M, _ASIDE_M), ylim=(-_BEHIND_M, _AHEAD_M), aspect="equal", facecolor=_colour(theme.CARD))
    axis.set_xlabel("m")


def errors_by_distance(path: Path, table: ErrorTable) -> None:
    """Share found and error of the place, by distance and by how dense people stand around.

    Args:
        path: of the picture (.png).
        table: what a detector found, and missed.
    """
    figure = Figure((9.6, 6.4), facecolor=_colour(theme.PAGE), layout="constrained")
    (found_near, found_dense), (error_near, error_dense) = figure.subplots(2, 2, sharey="row")
    error = np.hypot(table.error[:, 0], table.error[:, 1])
    bands = (("a third to two thirds seen", 1 / 3, 2 / 3), ("two thirds or more seen", 2 / 3, np.inf))
    columns = (
        (found_near, error_near, table.distance_m, np.linspace(1.0, 5.0, 9), "distance, m"),
        (found_dense, error_dense, table.density, np.linspace(0.0, 1.6, 9), "people per m² within 2 m of the person"),
    )
    for share_axis, error_axis, value, edges, label in columns:
        middle = 0.5 * (edges[1:] + edges[:-1])
        for (name, low, high), colour in zip(bands, (theme.PERSON, theme.ROBOT), strict=True):
            seen = (table.visible >= low) & (table.visible < high)
            rows = [seen & (value >= a) & (value < b) for a, b in itertools.pairwise(edges)]
            share = [table.found[row].mean() if row.sum() >= 20 else np.nan for row in rows]
            median = [np.nanmedian(error[row]) if (row & table.found).sum() >= 20 else np.nan for row in rows]
            share_axis.plot(middle, share, "o-", color=_colour(colour), label=name)
            error_axis.plot(middle, median, "o-", color=_colour(colour), label=name)
        error_axis.set_xlabel(label)
    found_near.set(ylabel="share of people found", ylim=(0, 1.02))
    error_near.set(ylabel="median error of the place, m")
    error_near.set_ylim(bottom=0)
    found_near.legend(frameon=False)
    for axis in (found_near, found_dense, error_near, error_dense):
        axis.grid(color=_colour(theme.BORDER))
        axis.set_facecolor(_colour(theme.CARD))
    figure.savefig(path, dpi=90)
