"""The worlds a run trains in, built from its configuration. The only place where learning constructs environments."""

from __future__ import annotations

import dataclasses
from typing import Any

from densecavoid.env.environments import DenseCAvoidVectorEnv
from densecavoid.env.observation import ObserverConfig
from densecavoid.learning.config import TrainConfig
from densecavoid.sim.spec import Scenario


def observer_config(config: TrainConfig) -> ObserverConfig:
    """What the policy is shown: the body's sensors, and people only where the sensor configuration predicts them."""
    return ObserverConfig(
        lidar=config.sim.lidar,
        camera=config.sim.camera,
        people_from=config.people_from if config.sensors == "densecavoid" else "nothing",
        horizons_s=(config.prediction_horizon_s,),
        control_dt_s=config.sim.control_dt_s,
        threads=config.sim.threads,
    )


def observer_json(config: TrainConfig) -> dict[str, Any]:
    """The same for a policy's file: what the runtime needs to show it the same (threads are the machine's affair)."""
    values = dataclasses.asdict(observer_config(config))
    del values["threads"]
    return values


def make_training_env(config: TrainConfig, scenario: Scenario) -> DenseCAvoidVectorEnv:
    """`config.num_envs` worlds drawn from `scenario`."""
    return DenseCAvoidVectorEnv(
        scenario,
        config.num_envs,
        sim=config.sim,
        observer=observer_config(config),
        reward=config.reward,
        seed=config.seed,
    )
