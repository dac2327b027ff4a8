"""Windows: the field's counts and constant-velocity errors, hand-made scenes, and no future in any past."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from densecavoid.perception.predictor.constant_velocity import ConstantVelocity
from densecavoid.perception.predictor.contract import Predictor
from densecavoid.perception.predictor.kalman import KalmanPredictor
from densecavoid.perception.predictor.training_data import _between_steps, batches, varied
from densecavoid.perception.predictor.windows import (
    HERMES_TEST,
    SCENES,
    Windows,
    cut,
    eth_ucy_test,
    eth_ucy_training,
    hermes,
    join,
    two_way_runs,
)

FIELD_S = [0.4 * step for step in range(1, 13)]


def anchors(data: Path, table: str) -> dict[str, list[float]]:
    """Rows of one table of the file of measured anchors: ADE12 FDE12 ADE8 FDE8 DE1 ADE3 FDE3 ADE5 FDE5."""
    text = (data / "eth_ucy" / "constant_velocity_anchors.txt").read_text()
    block = text.split(f"\n{table}\n")[1].split("\n\n")[0]
    return {words[0]: [float(word) for word in words[1:]] for words in map(str.split, block.splitlines()[1:])}


@pytest.mark.parametrize(
    "table, predictor, tolerance",
    [
        ("cv_last", ConstantVelocity(), 7e-4),
        ("cv_mean2", ConstantVelocity(over_s=0.8), 7e-4),
        ("kalman_q0.5_r0.05", KalmanPredictor(), 1e-3),  # how their filter begins is not told
    ],
)
def test_errors_on_eth_ucy_are_the_published_ones_to_the_third_digit(
    data_dir: Path, table: str, predictor: Predictor, tolerance: float
) -> None:
    expected = anchors(data_dir, table)
    for scene in SCENES:
        windows = eth_ucy_test(data_dir, scene)
        error = np.linalg.norm(predictor.predict(windows.histories(), FIELD_S).mean - windows.future, axis=2)
        ade12, fde12, ade8, fde8, de1, ade3, fde3, *_ = expected[scene]
        ours = [error.mean(), error[:, 11].mean(), error[:, :8].mean(), error[:, 7].mean(), error[:, 0].mean()]
        ours += [error[:, :3].mean(), error[:, 2].mean()]
        np.testing.assert_allclose(
            ours, [ade12, fde12, ade8, fde8, de1, ade3, fde3], rtol=0, atol=tolerance, err_msg=scene
        )


def test_windows_and_people_are_as_many_as_the_field_counts(data_dir: Path) -> None:
    text = (data_dir / "eth_ucy" / "constant_velocity_anchors.txt").read_text()
    for scene in SCENES:
        line = re.search(rf"^{scene} .*'windows': (\d+), 'ped_windows': (\d+)", text, re.MULTILINE)
        assert line is not None
        windows = eth_ucy_test(data_dir, scene)
        assert (len(np.unique(windows.group)), len(windows)) == (int(line[1]), int(line[2]))


def test_a_left_out_scene_is_left_out_and_the_others_keep_their_true_rate(data_dir: Path) -> None:
    fewer, late = eth_ucy_training(data_dir, without="univ", held_back=0.1)
    walks = {row.tobytes() for row in fewer.pos}
    assert not walks & {row.tobytes() for row in eth_ucy_test(data_dir, "univ").pos}
    assert walks & {row.tobytes() for row in eth_ucy_test(data_dir, "zara1").pos}
    assert 0.02 < len(late) / len(fewer) < 0.2
    moved = np.linalg.norm(late.pos[:, -1] - late.pos[:, 0], axis=1) > 1.0  # who stands leaves the same numbers twice
    assert moved.any() and not walks & {row.tobytes() for row in late.pos[moved]}
    # The published eth file is stretched: its people seem to walk at 2.3 m/s, and truly at about 1.4.
    speed = np.linalg.norm(np.diff(fewer.pos[:2000], axis=1), axis=2) / 0.4
    assert 1.1 < np.nanmedian(speed) < 1.7


def walks(steps: int = 12) -> np.ndarray:
    """Person 0 always there, person 1 until step 7, person 2 from step 5."""
    places = np.zeros((steps, 3, 2))
    places[..., 0] = 0.5 * np.arange(steps)[:, None] + np.arange(3)
    places[8:, 1] = np.nan
    places[:5, 2] = np.nan
    return places


def test_complete_windows_hold_people_seen_throughout_and_two_at_least() -> None:
    windows = cut(walks(), 0.4, 4, (1, 2, 3), complete=True)
    # 0 and 1 are there in steps 0-6 and 1-7; 0 and 2 in steps 5-11.
    assert windows.group.tolist() == [0, 0, 1, 1, 5, 5]
    np.testing.assert_allclose(windows.pos[0, :, 0], [0, 0.5, 1, 1.5])
    np.testing.assert_allclose(windows.future[0, :, 0], [2, 2.5, 3])
    assert windows.valid.all()


def test_open_windows_keep_short_histories_and_unknown_futures() -> None:
    windows = cut(walks(), 0.4, 4, (1, 3))
    rows = {
        (int(group), round(float(row[0]))): n
        for n, (group, row) in enumerate(
            zip(windows.group, windows.pos[:, -1] - 0.5 * windows.group[:, None], strict=True)
        )
    }
    newest = rows[5, 2]
    assert windows.valid[newest].tolist() == [False, False, False, True]
    leaving = rows[7, 1]
    assert np.isnan(windows.future[leaving]).all()
    assert rows[0, 0] == 0 and windows.valid[0].tolist() == [False, False, False, True]
    last = rows[10, 0]
    assert np.isfinite(windows.future[last, 0]).all() and np.isnan(windows.future[last, 1]).all()


def test_joined_windows_keep_their_groups_apart() -> None:
    part = cut(walks(), 0.4, 4, (1,))
    both = join([part, part])
    assert len(np.unique(both.group)) == 2 * len(np.unique(part.group))
    with pytest.raises(ValueError, match="windows is"):
        join([part, cut(walks(), 0.1, 4, (1,))])


def test_no_future_shows_in_a_past_between_recorded_steps() -> None:
    places = walks()
    bent = places.copy()
    bent[6:] += 3.0
    ours, theirs = _between_steps(places), _between_steps(bent)
    before = ours.group <= 5  # windows that end at step 5 or before
    np.testing.assert_array_equal(ours.pos[before], theirs.pos[before])
    assert np.isnan(ours.future[:, 0]).all() and np.isfinite(ours.future[:, 1]).any()
    np.testing.assert_allclose(ours.pos[ours.group == 5][0, -5:, 0], [2.0, 2.125, 2.25, 2.375, 2.5])


def test_hermes_heads_are_as_recorded_and_density_counts_people_around(data_dir: Path) -> None:
    run = HERMES_TEST[0]
    assert run in two_way_runs(data_dir) and "uo-100-300-300" not in two_way_runs(data_dir)
    windows = hermes(data_dir, run, 0.1, 32, (4,), stride=40, inside=True)
    assert (np.abs(windows.pos[:, -1, 1]) <= 4.0).all()
    assert 0.6 < np.median(windows.density) < 1.1  # .81 on average by the run's table
    group = windows.group == windows.group[len(windows) // 2]
    y = windows.pos[group, -1, 1]
    inner = np.abs(y) <= 1.9  # the stretch of these ends between the walls, where all people are in the window
    counted = (np.abs(y[inner, None] - y) <= 2.0).sum(axis=1) / (3.6 * 4.0)
    np.testing.assert_allclose(windows.density[group][inner], counted, rtol=1e-6)


def some_windows(groups: int = 40) -> Windows:
    rng = np.random.default_rng(0)
    return join([cut(rng.normal(size=(8, int(rng.integers(1, 5)), 2)), 0.1, 4, (1, 4)) for _ in range(groups)])


def test_batches_are_whole_groups_and_each_once() -> None:
    windows = some_windows()
    parts = list(batches(windows, 20, np.random.default_rng(1)))
    assert sum(map(len, parts)) == len(windows) and max(map(len, parts)) < 20 + 5
    groups = [set(part.group.tolist()) for part in parts]
    assert len(set.union(*groups)) == sum(map(len, groups))


def test_variation_keeps_the_shape_of_each_group() -> None:
    windows = some_windows()
    moved = varied(windows, "field", np.random.default_rng(2))
    group = windows.group == windows.group[-1]
    for name in ("future",):
        before, after = getattr(windows, name)[group], getattr(moved, name)[group]
        before, after = before[np.isfinite(before).all(axis=2)], after[np.isfinite(after).all(axis=2)]
        ratio = np.linalg.norm(after, axis=1) / np.linalg.norm(before, axis=1)
        np.testing.assert_allclose(ratio, ratio[0], rtol=1e-5)
