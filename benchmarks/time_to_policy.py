"""Time to a policy: minutes and environment steps of training until a policy is good in three test scenarios.

python benchmarks/time_to_policy.py --run base [--minutes 240] [--out runs/time_to_policy]
    trains, or goes on, and measures
python benchmarks/time_to_policy.py [--json FILE] [--out runs/time_to_policy]
    prints the table so far

`--run` names what is tried: `base`, one of the variants (each one change from `base`), or `sb3`: Stable-Baselines3's
PPO in the same worlds, curriculum, network and settings. Every `--every` steps the policy is tried on test worlds, with
the clock stopped; minutes are those of this machine, with what else it does.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from densecavoid.benchmark.evaluate import evaluate
from densecavoid.frames import Navigator

if TYPE_CHECKING:
    from densecavoid.learning.config import TrainConfig

WANTED = {"random-goal": 0.95, "random-sparse-ped": 0.87, "dense-ped": 0.90}
AIM_MINUTES = {"random-goal": 5, "random-sparse-ped": 60, "dense-ped": 180}


@dataclass(frozen=True)
class Trial:
    """One look at a policy."""

    steps: int
    minutes: float
    """Of training alone."""
    success: dict[str, float]


def base(run_dir: Path) -> TrainConfig:
    """Depth, lidar and prediction, the compact network, the defaults of `densecavoid train`."""
    from densecavoid.learning.config import TrainConfig

    return TrainConfig(run_dir=run_dir, name=run_dir.name)


def variants() -> dict[str, Callable[[TrainConfig], TrainConfig]]:
    """One change each, or what belongs together."""
    from densecavoid.learning.foreseen_worlds import ForesightConfig

    def ppo(**changes: Any) -> Callable[[TrainConfig], TrainConfig]:
        return lambda config: replace(config, ppo=replace(config.ppo, **changes))

    def curriculum(**changes: Any) -> Callable[[TrainConfig], TrainConfig]:
        return lambda config: replace(config, curriculum=replace(config.curriculum, **changes))

    return {
        "base": lambda config: config,
        "privileged-critic": lambda config: replace(config, privileged_critic=True),
        "separate-critic": lambda config: replace(config, critic="separate"),
        "normalised-values": lambda config: replace(config, normalise_values=True),
        "normalised-inputs": lambda config: replace(config, normalise_inputs=True),
        "lasting-noise": lambda config: replace(config, noise_persistence=0.7),
        "mirror": ppo(mirror=True),
        "whole-reward": ppo(reward_scale=1.0),
        "small-minibatches": ppo(minibatch_size=256),
        "large-minibatches": ppo(minibatch_size=2048),
        "few-passes": ppo(epochs=2),
        "many-passes": ppo(epochs=8),
        "far-sighted": ppo(discount=0.995),
        "fine-levels": curriculum(level_step=0.05, window=100),
        "strict-levels": curriculum(threshold=0.85),
        "more-worlds": lambda config: replace(config, num_envs=128, steps_per_rollout=32),
        "long-prediction": lambda config: replace(config, prediction_horizon_s=1.6),
        "foresight": lambda config: replace(
            config,
            foresight=ForesightConfig(steps=1_500_000),
            ppo=replace(config.ppo, learning_rate=1e-4),
        ),
        "wide-berth": lambda config: replace(config, reward=replace(config.reward, safe_distance_threshold_m=1.2)),
    }


def try_out(navigator: Navigator, episodes: int, scenarios: Sequence[str]) -> dict[str, float]:
    """Success rates on the benchmark's first test worlds (of `random-goal`: on its seeds, at the highest level)."""
    return {name: float(evaluate(navigator, name, episodes)["success"]) for name in scenarios}  # type: ignore[arg-type]


def reached(trials: Sequence[Trial], scenario: str) -> Trial | None:
    """The first trial in which the policy was as good as wanted."""
    return next((trial for trial in trials if trial.success.get(scenario, 0.0) >= WANTED[scenario]), None)


def read_trials(path: Path) -> list[Trial]:
    """What was measured so far."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return [Trial(**json.loads(line)) for line in lines]


def measure(
    path: Path,
    learn: Callable[[int], tuple[int, float, Navigator]],
    every: int,
    minutes: float,
    episodes: int,
) -> None:
    """Trains and tries in turn until all is reached or the minutes are spent; one line a trial in `path`.

    Args:
        path: file of trials, continued.
        learn: trains until so many steps in all, and gives steps, minutes of training in all, and the policy.
        every: steps between two trials.
        minutes: of training, in all.
        episodes: of a trial, in each scenario.
    """
    trials = read_trials(path)
    while not all(reached(trials, name) for name in WANTED):
        if trials and trials[-1].minutes >= minutes:
            break
        before = trials[-1].steps if trials else 0
        steps, spent, navigator = learn(before + every)
        trials.append(Trial(steps, spent, try_out(navigator, episodes, tuple(WANTED))))
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(vars(trials[-1])) + "\n")
        print(f"{path.stem}: {steps:,} steps, {spent:.1f} min, {trials[-1].success}", flush=True)
        if steps < before + every:
            sys.exit("stopped; to go on, give the same command again")


def learner_of_ours(config: TrainConfig) -> Callable[[int], tuple[int, float, Navigator]]:
    """Goes on with the run in the configuration's folder."""
    from densecavoid.learning.run import resume, train
    from densecavoid.learning.run_folder import RunFolder
    from densecavoid.policy.navigator import load_policy

    def learn(total: int) -> tuple[int, float, Navigator]:
        folder = RunFolder(config.run_dir)
        if folder.config_file.exists():
            result = resume(config.run_dir, total_steps=total)
        else:
            result = train(replace(config, total_steps=total))
        records = [json.loads(line) for line in folder.metrics_file.read_text(encoding="utf-8").splitlines()]
        parts = ("time/collect_s", "time/update_s", "time/worlds_s")
        seconds = sum(record.get(part, 0.0) for record in records for part in parts)  # older runs know two
        return result.steps, seconds / 60, load_policy(str(result.policy))

    return learn


def learner_of_stable_baselines3(config: TrainConfig) -> Callable[[int], tuple[int, float, Navigator]]:
    """Its PPO in the same worlds, promoted by the same curriculum; kept in the folder between trials."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))
    import stable_baselines3_ppo as example
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback

    from densecavoid.frames import Observation
    from densecavoid.learning.curriculum import Curriculum
    from densecavoid.learning.worlds import make_training_envs, observer_json
    from densecavoid.policy.card import PolicyCard
    from densecavoid.policy.navigator import PolicyNavigator

    folder = config.run_dir
    folder.mkdir(parents=True, exist_ok=True)
    saved, notes = folder / "sb3.zip", folder / "sb3.json"
    curriculum = Curriculum(config.curriculum, config.stages)
    kept: dict[str, Any] = json.loads(notes.read_text(encoding="utf-8")) if notes.exists() else {"minutes": 0.0}
    if "curriculum" in kept:
        curriculum.load_state_dict(kept["curriculum"])
    worlds = example.BatchedWorlds(make_training_envs(config, curriculum.scenario())[0])
    worlds.seed(config.seed)
    if saved.exists():
        ppo = PPO.load(saved, env=worlds)
    else:
        ppo = example.make_ppo(
            worlds,
            n_steps=config.steps_per_rollout,
            batch_size=config.ppo.minibatch_size,
            n_epochs=config.ppo.epochs,
            learning_rate=config.ppo.learning_rate,
            target_kl=config.ppo.target_kl,
            ent_coef=config.ppo.entropy_weight,
            max_grad_norm=config.ppo.max_gradient_norm,
            seed=config.seed,
        )

    class Promotion(BaseCallback):
        """Tells the curriculum of episodes, and moves the worlds when it moves; scales rewards as ours are scaled."""

        def _on_step(self) -> bool:
            ended = [info for info in self.locals["infos"] if info]
            self.locals["rewards"] *= config.ppo.reward_scale
            names, successes = [info["scenario"] for info in ended], [info["is_success"] for info in ended]
            if curriculum.update(names, successes):
                worlds.worlds.scenario = curriculum.scenario()
            return True

    class Policy:
        """What `PolicyNavigator` asks of a policy."""

        card = PolicyCard(
            name="sb3",
            sensors=config.sensors,
            network={},
            observation=json.loads(json.dumps(observer_json(config))),
            log_std=(-1.0, -1.0),
            max_linear_velocity=config.sim.robot.max_linear_velocity,
            max_angular_velocity=config.sim.robot.max_angular_velocity,
            weights_sha256="",
        )

        def __call__(self, observation: Observation, noise: np.ndarray | None = None) -> np.ndarray:
            assert noise is None, "Gaussian policies act with the mean"
            return ppo.predict(observation._asdict(), deterministic=True)[0]

    def learn(total: int) -> tuple[int, float, Navigator]:
        start = time.monotonic()
        ppo.learn(total - ppo.num_timesteps, callback=Promotion(), reset_num_timesteps=False)
        kept["minutes"] += (time.monotonic() - start) / 60
        ppo.save(saved)
        notes.write_text(json.dumps(kept | {"curriculum": curriculum.state_dict()}) + "\n", encoding="utf-8")
        return ppo.num_timesteps, kept["minutes"], PolicyNavigator(Policy())

    return learn


def table(out: Path) -> list[dict[str, Any]]:
    """A row for each thing tried, with what was reached when, or the best success so far."""
    rows = []
    for path in sorted(out.glob("*.jsonl")):
        trials = read_trials(path)
        row: dict[str, Any] = {"run": path.stem, "steps": trials[-1].steps, "minutes": trials[-1].minutes}
        for name in WANTED:
            first = reached(trials, name)
            best = max(trial.success[name] for trial in trials)
            row[name] = {"steps": first.steps, "minutes": first.minutes} if first else {"best": best}
        rows.append(row)
    return rows


def print_table(rows: Sequence[dict[str, Any]]) -> None:
    """As Markdown."""
    print("| run | steps | minutes | " + " | ".join(f"{name} >= {rate:.2f}" for name, rate in WANTED.items()) + " |")
    print("|---" * (3 + len(WANTED)) + "|")
    for row in rows:
        cells = [
            f"{row[name]['minutes']:.0f} min, {row[name]['steps'] / 1e6:.2f} M"
            if "steps" in row[name]
            else f"not yet (best {row[name]['best']:.2f})"
            for name in WANTED
        ]
        print(f"| {row['run']} | {row['steps'] / 1e6:.2f} M | {row['minutes']:.0f} | " + " | ".join(cells) + " |")
    print("| aim | | | " + " | ".join(f"{minutes} min" for minutes in AIM_MINUTES.values()) + " |")


def main(args: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", help="what to try", metavar="NAME")
    parser.add_argument("--minutes", type=float, default=240.0, help="of training, in all")
    parser.add_argument("--every", type=int, default=250_000, help="steps between two trials")
    parser.add_argument("--episodes", type=int, default=100, help="test worlds of a trial, in each scenario")
    parser.add_argument("--out", type=Path, default=Path("runs/time_to_policy"))
    parser.add_argument("--json", type=Path, help="file for the table")
    options = parser.parse_args(args)
    if options.run:
        if importlib.util.find_spec("torch") is None:
            sys.exit("training needs torch: pip install 'densecavoid[train]'")
        known = variants()
        if options.run not in (*known, "sb3"):
            sys.exit(f"unknown run {options.run!r}, expected sb3 or one of: {', '.join(known)}")
        options.out.mkdir(parents=True, exist_ok=True)
        config = known.get(options.run, known["base"])(base(options.out / options.run))
        learner = learner_of_stable_baselines3 if options.run == "sb3" else learner_of_ours
        measure(options.out / f"{options.run}.jsonl", learner(config), options.every, options.minutes, options.episodes)
    rows = table(options.out)
    print_table(rows)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
