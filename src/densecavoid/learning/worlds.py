"""The worlds a run trains in, built from its configuration. The only place where learning constructs environments."""

from __future__ import annotations

import dataclasses
from typing import Any

from densecavoid.env.environments import DenseCAvoidVectorEnv
from densecavoid.env.observation import ObserverConfig
from densecavoid.learning.config import TrainConfig
from densecavoid.learning.foreseen_envs import ForeseenVectorEnv
from densecavoid.learning.foreseen_worlds import ForeseenWorlds
from densecavoid.learning.variety import vary_body
from densecavoid.sim.spec import Scenario


def observer_config(config: TrainConfig) -> ObserverConfig:
    """What the policy is shown: the body's sensors, and people only where the sensor configuration predicts them."""
    return ObserverConfig(
        lidar=config.sim.lidar,
        camera=config.sim.camera,
        people_from=config.people_from if config.sensors == "densecavoid" else "nothing",
        horizons_s=(config.prediction_horizon_s,),
        control_dt_s=config.sim.control_dt_s,
        robot=config.sim.robot,
        remembers=config.remembers,
        foretold_s=config.foretold_s,
        route_every_s=config.route_every_s,
        weighs_commands=config.weighs_commands,
        threads=config.sim.threads,
    )


def observer_json(config: TrainConfig) -> dict[str, Any]:
    """The same for a policy's file: what the runtime needs to show it the same (threads are the machine's affair)."""
    values = dataclasses.asdict(observer_config(config))
    del values["threads"]
    return values


def make_training_envs(config: TrainConfig, scenario: Scenario, first_world: int = 0) -> list[DenseCAvoidVectorEnv]:
    """`config.num_envs` worlds drawn from `scenario`, in groups.

    Args:
        config: settings.
        scenario: where worlds are drawn from; `ForeseenWorlds` reward with what they know.
        first_world: number of the first of them among the worlds of all processes.
    """
    size = config.num_envs // config.num_groups
    network = config.network_config
    envs: list[DenseCAvoidVectorEnv] = []
    for first in range(first_world, first_world + config.num_envs, size):
        sim = vary_body(config.sim, config.seed, first // size) if config.variety.bodies > 0 else config.sim
        settings: dict[str, Any] = {
            "sim": sim,
            "observer": dataclasses.replace(observer_config(config), lidar=sim.lidar, camera=sim.camera),
            "reward": config.reward,
            "seed": config.seed,
            "first_world": first,
            "true_people": network.num_people if network.privileged or config.imitation.teacher is not None else 0,
        }
        if isinstance(scenario, ForeseenWorlds):
            envs.append(ForeseenVectorEnv(scenario, size, **settings))
        else:
            envs.append(DenseCAvoidVectorEnv(scenario, size, **settings))
    return envs
