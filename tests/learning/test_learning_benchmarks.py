"""Promises of the benchmarks of learning: what they read from runs, and what they conclude."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

import figure5
import time_to_policy


def write_run(folder: Path, progress: list[float], returns: list[float | None]) -> None:
    folder.mkdir(parents=True)
    lines = []
    for i, (level, reward) in enumerate(zip(progress, returns, strict=True)):
        record = {"steps": 100 * (i + 1), "curriculum/stage_index": 0, "curriculum/level/random-goal": level}
        lines.append(json.dumps(record | ({} if reward is None else {"episode/return": reward})) + "\n")
    (folder / "metrics.jsonl").write_text("".join(lines))


def runs(out: Path, with_prediction: list[int], without: list[int]) -> None:
    """Runs that come to level 1 at these iterations of 12."""
    for sensors, numbers in (("densecavoid", with_prediction), ("depth-lidar", without)):
        for seed, number in enumerate(numbers):
            progress = [float(i + 1 >= number) for i in range(12)]
            write_run(out / f"{sensors}-{seed}", progress, [None, *np.linspace(-5, 10, 11)])


@pytest.mark.parametrize(
    ("using", "without", "words"),
    [
        ([3, 4, 5], [6, 7, 8], "prediction converges faster in all runs (4 iterations with prediction, 7 without)"),
        ([6, 7, 8], [3, 4, 5], "prediction converges more slowly in all runs"),
        ([3, 4, 7], [6, 7, 8], "no difference beyond the spread between seeds"),
    ],
)
def test_the_verdict_on_prediction_needs_all_seeds(
    tmp_path: Path, capsys: pytest.CaptureFixture, using: list[int], without: list[int], words: str
) -> None:
    runs(tmp_path, using, without)
    figure5.main(["--out", str(tmp_path)])
    assert words in capsys.readouterr().out
    verdict = json.loads((tmp_path / "figure5.json").read_text())
    assert verdict["iterations"] == {"densecavoid": using, "depth-lidar": without}
    assert (tmp_path / "figure5.png").stat().st_size > 10_000


def test_without_runs_nothing_is_claimed(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    figure5.main(["--out", str(tmp_path)])
    assert "does not hold runs of both kinds" in capsys.readouterr().out


def test_a_smoothed_curve_is_the_mean_of_the_last_values_that_are_there() -> None:
    values = np.array([1.0, np.nan, 3.0, 5.0, np.nan, np.nan, np.nan])
    expected = [1.0, 1.0, 2.0, 4.0, 4.0, 5.0, np.nan]
    np.testing.assert_allclose(figure5.smooth(values, 3), expected)


def test_time_to_a_policy_is_that_of_the_first_trial_that_is_good_enough(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    trials = [
        (100_000, 1.0, {"random-goal": 0.90, "random-sparse-ped": 0.1, "dense-ped": 0.2}),
        (200_000, 2.5, {"random-goal": 0.96, "random-sparse-ped": 0.5, "dense-ped": 0.4}),
        (300_000, 4.0, {"random-goal": 0.94, "random-sparse-ped": 0.3, "dense-ped": 0.91}),
    ]
    lines = [json.dumps({"steps": s, "minutes": m, "success": r}) + "\n" for s, m, r in trials]
    (tmp_path / "base.jsonl").write_text("".join(lines))
    time_to_policy.main(["--out", str(tmp_path), "--json", str(tmp_path / "table.json")])
    (row,) = json.loads((tmp_path / "table.json").read_text())
    assert row["random-goal"] == {"steps": 200_000, "minutes": 2.5}
    assert row["random-sparse-ped"] == {"best": 0.5}
    assert row["dense-ped"] == {"steps": 300_000, "minutes": 4.0}
    assert "| base | 0.30 M | 4 | 2 min, 0.20 M | not yet (best 0.50) | 4 min, 0.30 M |" in capsys.readouterr().out


def test_trials_go_on_until_all_is_reached_and_continue_where_they_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def learn(total: int) -> tuple[int, float, str]:
        asked.append(total)
        return total, total / 100, f"policy of {total}"

    def try_out(navigator: str, episodes: int, scenarios: tuple[str, ...]) -> dict[str, float]:
        good = float(navigator == "policy of 30")
        return {name: good for name in scenarios}

    monkeypatch.setattr(time_to_policy, "try_out", try_out)
    path = tmp_path / "x.jsonl"
    time_to_policy.measure(path, learn, every=10, minutes=0.15, episodes=1)  # type: ignore[arg-type]
    assert asked == [10, 20], "the minutes are spent"
    time_to_policy.measure(path, learn, every=10, minutes=99, episodes=1)  # type: ignore[arg-type]
    assert asked == [10, 20, 30]


def test_every_variant_is_one_change_from_the_base(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    base = time_to_policy.base(tmp_path)
    for name, change in time_to_policy.variants().items():
        changed = change(base)
        different = [field for field in vars(base) if getattr(base, field) != getattr(changed, field)]
        assert different == [] if name == "base" else 1 <= len(different) <= 2, name


@pytest.mark.slow
def test_figure_5_trains_what_is_missing_and_goes_on_where_it_was(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    small = {"num_envs": 2, "steps_per_rollout": 16, "threads": 1}
    figure5.run_all(tmp_path, seeds=1, steps=32, **small)
    assert [figure5.last_step(tmp_path / f"{sensors}-0") for sensors in figure5.SENSORS] == [32, 32]
    figure5.run_all(tmp_path, seeds=1, steps=64, **small)
    assert len(figure5.read_curve(tmp_path / "depth-lidar-0").reward) == 2
    written = (tmp_path / "densecavoid-0" / "metrics.jsonl").read_bytes()
    figure5.run_all(tmp_path, seeds=1, steps=64, **small)
    assert (tmp_path / "densecavoid-0" / "metrics.jsonl").read_bytes() == written, "nothing is missing"


@pytest.mark.slow
@pytest.mark.parametrize("who", ["ours", "sb3"])
def test_time_to_a_policy_can_be_measured_of_both_trainers(tmp_path: Path, who: str) -> None:
    pytest.importorskip("torch")
    if who == "sb3":
        pytest.importorskip("stable_baselines3")
    base = time_to_policy.base(tmp_path / "run")
    small = dataclasses.replace(base.ppo, minibatch_size=32)
    config = dataclasses.replace(base, num_envs=2, steps_per_rollout=16, stage="random-goal", threads=1, ppo=small)
    make = {"ours": time_to_policy.learner_of_ours, "sb3": time_to_policy.learner_of_stable_baselines3}[who]
    steps, minutes, navigator = make(config)(32)
    assert steps == 32 and minutes > 0
    assert 0.0 <= time_to_policy.try_out(navigator, 1, ("random-goal",))["random-goal"] <= 1.0
    steps, later, _ = make(config)(64)  # as a new process would
    assert steps == 64 and later > minutes
