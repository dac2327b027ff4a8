"""Tunes a classical navigator by random search: `python benchmarks/tune_baselines.py orca --candidates 30`.

Worlds are of training scenarios and places, never of tests. All candidates drive in some worlds, the better third of
them in more. Goes on where it was stopped (`--out`).
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from densecavoid.baselines.dwa import Dwa, DwaConfig
from densecavoid.baselines.frozone import Frozone, FrozoneConfig
from densecavoid.baselines.lookahead import Lookahead
from densecavoid.baselines.orca import Orca, OrcaConfig
from densecavoid.baselines.social_force import SocialForce, SocialForceConfig
from densecavoid.benchmark.metrics import episode_metrics
from densecavoid.benchmark.rollout import run_episodes
from densecavoid.frames import Navigator
from densecavoid.perception.outlook import OutlookConfig
from densecavoid.policy.navigator import load_policy
from densecavoid.scenarios import PLACES, TRAINING
from densecavoid.sim.spec import Scenario
from densecavoid.sim.world import SimConfig, Simulator

SCENARIOS: tuple[Scenario, ...] = (
    TRAINING["cluttered-static"],
    TRAINING["random-pedestrians"],
    TRAINING["dense-random-pedestrians"].at_level(0.6),
    PLACES["lobby"],
    PLACES["crossing"],
)

Ranges = dict[str, tuple[float, float]]
NAVIGATORS: dict[str, tuple[Any, Callable[[Any], Navigator], Ranges]] = {
    "dwa": (
        DwaConfig(),
        lambda config: Dwa(config=config),
        {
            "horizon_s": (1.25, 4.0),
            "window_s": (0.2, 1.0),
            "keep_m": (0.31, 0.5),
            "comfort_m": (0.55, 1.4),
            "heading": (0.1, 1.5),
            "clearance": (0.2, 2.0),
            "speed": (0.02, 0.5),
            "detour": (0.5, 4.0),
        },
    ),
    "social-force": (
        SocialForceConfig(),
        lambda config: SocialForce(config=config),
        {
            "relaxation_s": (0.3, 1.0),
            "people_m_s2": (0.7, 6.0),
            "people_range_m": (0.25, 1.2),
            "foresight_s": (0.5, 4.0),
            "things_m_s2": (0.5, 5.0),
            "things_range_m": (0.1, 0.5),
        },
    ),
    "orca": (
        OrcaConfig(),
        lambda config: Orca(config=config),
        {
            "horizon_s": (1.5, 8.0),
            "thing_horizon_s": (0.3, 2.0),
            "responsibility": (0.5, 1.0),
            "tracking_error_m": (0.03, 0.3),
            "unseen_m": (0.01, 0.2),
        },
    ),
    "lookahead": (
        OutlookConfig(),
        lambda config: Lookahead(config=config),
        {
            "slip": (0.03, 0.2),
            "margin_m": (0.0, 0.06),
            "near_person_risk": (0.005, 0.1),
            "turned_risk": (0.0, 0.3),
            "near_thing_slower": (0.5, 6.0),
            "beyond_slower": (1.2, 2.5),
            "doubt_m_s": (0.0, 0.2),
        },
    ),
    "frozone": (
        FrozoneConfig(),
        lambda config: Frozone(load_policy("densecavoid"), config=config),
        {
            "square_m": (2.0, 6.0),
            "look_ahead_s": (0.8, 4.0),
            "clearance_m": (0.3, 0.7),
            "max_turn_rad": (0.5, 1.6),
            "turn_time_s": (0.4, 2.0),
        },
    ),
}


@dataclass(frozen=True)
class Tune:
    """What to tune, and how long."""

    navigator: tyro.conf.Positional[str]
    """dwa, social-force, orca, lookahead or frozone."""
    candidates: int = 30
    """Beside the defaults."""
    worlds: int = 16
    """Of each scenario, for every candidate; the better third drives in three times as many more."""
    seed: int = 0
    out: Path = Path("runs/tune")
    """Folder of what has been measured."""


def score(navigator: Navigator, seeds: range) -> dict[str, float]:
    """Success in each scenario."""
    rates = {}
    for scenario in SCENARIOS:
        simulator = Simulator(scenario, min(16, len(seeds)), SimConfig(threads=1))
        figures = [episode_metrics(episode) for episode in run_episodes(simulator, navigator, seeds)]
        rates[scenario.name] = float(np.mean([figure.success for figure in figures]))
    return rates


def main(tune: Tune) -> None:
    """Prints the best configurations."""
    default, make, ranges = NAVIGATORS[tune.navigator]
    rng = np.random.default_rng(tune.seed)
    candidates = [default]
    while len(candidates) <= tune.candidates:
        drawn = {name: round(float(np.exp(rng.uniform(*np.log(ends)))), 3) for name, ends in ranges.items()}
        candidates.append(replace(default, **drawn))
    path = tune.out / f"{tune.navigator}.jsonl"
    path.parent.mkdir(parents=True, exist_ok=True)
    known = {}
    if path.is_file():
        for line in path.read_text(encoding="utf-8").splitlines():
            row = json.loads(line)
            known[json.dumps([row["config"], row["seeds"]])] = row["success"]

    def measured(config: Any, seeds: range) -> float:
        key = json.dumps([asdict(config), [seeds.start, seeds.stop]])
        if key not in known:
            known[key] = score(make(config), seeds)
            row = {"config": asdict(config), "seeds": [seeds.start, seeds.stop], "success": known[key]}
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
        return float(np.mean(list(known[key].values())))

    first, more = range(tune.worlds), range(tune.worlds, 4 * tune.worlds)
    ranked = sorted(candidates, key=lambda config: -measured(config, first))
    final = {k: 0.25 * measured(c, first) + 0.75 * measured(c, more) for k, c in enumerate(ranked[: len(ranked) // 3])}
    for k, value in sorted(final.items(), key=lambda item: -item[1])[:5]:
        print(f"{value:.3f} {asdict(ranked[k])}", flush=True)
    print(f"{0.25 * measured(default, first) + 0.75 * measured(default, more):.3f} the defaults")


if __name__ == "__main__":
    main(tyro.cli(Tune))
