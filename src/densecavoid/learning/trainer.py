"""The state of a training run and its one step: worlds, curriculum, PPO. Files, logs and the panel are in `run`."""

from __future__ import annotations

import dataclasses
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

import numpy as np
import torch
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from densecavoid.frames import require
from densecavoid.learning import ppo
from densecavoid.learning.checkpoint import as_tensors
from densecavoid.learning.collector import Collector, Teacher
from densecavoid.learning.config import TrainConfig
from densecavoid.learning.curriculum import Curriculum
from densecavoid.learning.foreseen_envs import ForeseenVectorEnv
from densecavoid.learning.foreseen_worlds import ForeseenWorlds
from densecavoid.learning.guidance import guide
from densecavoid.learning.imitation import imitate
from densecavoid.learning.machine import prepare
from densecavoid.learning.peers import Peers
from densecavoid.learning.rollout import Rollout
from densecavoid.learning.variety import vary_places
from densecavoid.learning.worlds import make_training_envs
from densecavoid.networks.config_json import to_json
from densecavoid.policy.export import load_safetensors
from densecavoid.policy.network import ActorCritic
from densecavoid.sim.spec import Scenario

_RECENT_EPISODES = 200
MakeEnvs = Callable[[TrainConfig, Scenario, int], Sequence[Any]]
"""Settings, scenario and number of the first world -> groups of worlds."""


class Trainer:
    """The state of a run: network, optimiser, random generator, worlds, curriculum and counters. One `iterate` collects
    a rollout and learns from it. In several processes, all call the same methods in the same order.
    """

    def __init__(
        self,
        config: TrainConfig,
        make_envs: MakeEnvs = make_training_envs,
        peers: Peers = Peers(),  # noqa: B008
        state: dict[str, Any] | None = None,
    ) -> None:
        """
        Args:
            config: settings.
            make_envs: builds the worlds; for tests.
            peers: the processes that train together.
            state: of an earlier trainer, to go on from.

        Raises:
            ValueError: if weights to start from, or a teacher's, are of another network than the settings ask for; or
                as `load_state_dict`.
        """
        self.config = config
        self.peers = peers
        self.device = config.torch_device
        prepare(config.threads, self.device)
        torch.manual_seed(config.seed)
        self.network = self._initial_network().to(self.device)
        self.network.set_compute_dtype(config.torch_dtype)
        self._averaged = (
            AveragedModel(self.network, multi_avg_fn=get_ema_multi_avg_fn(config.averaging))
            if config.averaging > 0
            else None
        )
        self.teacher = self._load_teacher()
        if config.compiled:
            self.network.compile()
        self.optimiser = ppo.make_optimiser(self.network, config.ppo)
        self.generator = torch.Generator(self.device).manual_seed(config.seed)
        self.curriculum = Curriculum(config.curriculum, config.stages)
        self.ppo_config, self.foreseen = config.ppo, None
        if config.foresight.steps > 0:
            self.ppo_config = dataclasses.replace(config.ppo, discount=config.foresight.values.discount)
            self.foreseen = ForeseenWorlds(config.foresight, config.sim, config.seed)
            if state is None:
                self.foreseen.fill()
            else:
                self.foreseen.load_state_dict(state["foreseen"])
        self.envs = make_envs(config, self.foreseen or self._scenario(), peers.rank * config.num_envs)
        self.collector = Collector(
            self.envs,
            config.steps_per_rollout,
            config.sensors,
            config.ppo.reward_scale,
            self.device,
            peers=peers,
            lidar_dtype=torch.float16 if config.storage == "float16" else torch.float32,
        )
        self.collector.reset(config.seed)
        self.steps = 0
        self.iteration = 0
        self.best_score = (-1, -1.0, -1.0)
        self.recent: dict[str, deque[bool]] = {}
        if state is not None:
            self.load_state_dict(state)

    @property
    def steps_per_iteration(self) -> int:
        """Environment steps, over all processes, between two updates."""
        return self.config.num_envs * self.config.steps_per_rollout * self.peers.count

    def iterate(self, on_step: Callable[[], None] = lambda: None) -> dict[str, Any]:
        """Collects, learns, moves the curriculum.

        Returns:
            A flat record for the logs.

        Raises:
            TrainingDivergedError, PeerLostError: as `ppo.update`.
        """
        started_s = time.perf_counter()
        teacher = self._teacher_now()
        persistence = (self.config.foresight if self.guided else self.config).noise_persistence
        rollout = self.collector.collect(self.network, self.generator, on_step, teacher, persistence)
        collected_s = time.perf_counter()
        name, learned = self._learn(rollout, teacher)
        ppo.follow_inputs(self.network, rollout, self.peers)
        if self._averaged is not None:
            self._averaged.update_parameters(self.network)
        updated_s = time.perf_counter()
        self.steps += self.steps_per_iteration
        self.iteration += 1
        episodes = rollout.episodes
        for scenario, success in zip(episodes.scenario, episodes.success, strict=True):
            self.recent.setdefault(scenario, deque(maxlen=_RECENT_EPISODES)).append(success)
        if self.foreseen is not None:
            self.foreseen.renew()
        elif self.curriculum.update(episodes.scenario, episodes.success):
            self._move_worlds()
        ended_s = time.perf_counter()
        return {
            "iteration": self.iteration,
            "steps": self.steps,
            "time/steps_per_s": self.steps_per_iteration / (ended_s - started_s),
            "time/collect_s": collected_s - started_s,
            "time/update_s": updated_s - collected_s,
            "time/worlds_s": ended_s - updated_s,
            "curriculum/stage": self.stage,
            "curriculum/stage_index": self.curriculum.stage_index,
            **{f"curriculum/level/{part.scenario}": part.level for part in self.curriculum.mixture()},
            **_episode_means(rollout),
            **{f"success/{name}": float(np.mean(outcomes)) for name, outcomes in self.recent.items()},
            **{f"reward/{name}": value for name, value in rollout.reward_terms.items()},
            **{f"{name}/{key}": value for key, value in dataclasses.asdict(learned).items()},
        }

    @property
    def policy(self) -> ActorCritic:
        """What is given out: the weights of the last update, or with `averaging` their mean over the updates."""
        return self.network if self._averaged is None else cast(ActorCritic, self._averaged.module)

    @property
    def stage(self) -> str:
        """What is being learned: the curriculum's stage, or in foreseen worlds `guided`, then `foreseen`."""
        if self.foreseen is None:
            return self.curriculum.stage
        return "guided" if self.guided else "foreseen"

    @property
    def guided(self) -> bool:
        """Whether it learns directly what commands are worth."""
        return self.steps < self.config.foresight.steps

    @property
    def score(self) -> tuple[int, float, float]:
        """Grows as training succeeds: stage, then levels, then success rate (-1 until the window is full). In foreseen
        worlds the mean of all scenarios' success rates alone.
        """
        if self.foreseen is not None:
            rates = [
                float(np.mean(recent)) if len(recent) == recent.maxlen else -1.0 for recent in self.recent.values()
            ]
            return (0, 0.0, float(np.mean(rates)) if rates and min(rates) >= 0 else -1.0)
        rate = self.curriculum.success_rate if self.curriculum.window_full else -1.0
        return (self.curriculum.stage_index, sum(self.curriculum.levels), rate)

    def state_dict(self) -> dict[str, Any]:
        """Everything that the continuation depends on, of all processes.

        Raises:
            PeerLostError: if another process is gone.
        """
        envs = {str(g): env.state_dict() for g, env in enumerate(self.envs)}
        worlds = self.peers.gather({"collector": _as_arrays(self.collector.state_dict()), "envs": envs})
        optimiser = self.optimiser.state_dict()
        return {
            "counters": {"steps": self.steps, "iteration": self.iteration, "best_score": list(self.best_score)},
            "network_config": to_json(self.network.config),
            "network": self.network.state_dict(),
            "averaged": {} if self._averaged is None else self.policy.state_dict(),
            "optimiser": {
                "state": {str(index): entries for index, entries in optimiser["state"].items()},
                "groups": optimiser["param_groups"],
            },
            "generator": self.generator.get_state(),
            "curriculum": self.curriculum.state_dict(),
            "foreseen": {} if self.foreseen is None else self.foreseen.state_dict(),
            "recent": {name: [int(outcome) for outcome in outcomes] for name, outcomes in self.recent.items()},
            "worlds": {str(rank): state for rank, state in enumerate(worlds)},
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues as if the run had never stopped: the same bits follow, on the same machine and thread count.

        Raises:
            ValueError: if the checkpoint is of another network than this version builds from the same settings, or of
                another number of processes.
        """
        built, processes = to_json(self.network.config), len(state["worlds"])
        require(state["network_config"] == built, "the checkpoint's network", state["network_config"], built)
        require(processes == self.peers.count, "the checkpoint's number of processes", processes, str(self.peers.count))
        self.steps = state["counters"]["steps"]
        self.iteration = state["counters"]["iteration"]
        stage, level, rate = state["counters"]["best_score"]
        self.best_score = (stage, level, rate)
        self.network.load_state_dict(as_tensors(state["network"]))
        if self._averaged is not None:
            self.policy.load_state_dict(as_tensors(state["averaged"]))
            self._averaged.n_averaged.fill_(self.iteration)
        self.optimiser.load_state_dict(
            {
                "state": {int(i): as_tensors(entries) for i, entries in state["optimiser"].get("state", {}).items()},
                "param_groups": state["optimiser"]["groups"],
            }
        )
        self.generator.set_state(torch.from_numpy(state["generator"]))
        self.curriculum.load_state_dict(state["curriculum"])
        self.recent = {
            name: deque((bool(outcome) for outcome in outcomes), maxlen=_RECENT_EPISODES)
            for name, outcomes in state["recent"].items()
        }
        if self.foreseen is not None:
            self.foreseen.load_state_dict(state["foreseen"])
        else:
            self._move_worlds()
        own = state["worlds"][str(self.peers.rank)]
        for g, env in enumerate(self.envs):
            env.load_state_dict(own["envs"][str(g)])
        self.collector.load_state_dict(own["collector"])

    def close(self) -> None:
        """Closes the worlds."""
        self.collector.close()
        for env in self.envs:
            env.close()
        if self.foreseen is not None:
            self.foreseen.close()

    def _learn(self, rollout: Rollout, teacher: Teacher | None) -> tuple[str, Any]:
        """From whom, and what happened."""
        config, foresight = self.ppo_config, self.config.foresight
        settings = (self.network, self.optimiser, rollout)
        if self.guided:
            env = self.envs[0]
            assert isinstance(env, ForeseenVectorEnv)
            self.network.set_std(foresight.std(self.steps))
            done = self.steps / foresight.steps
            ppo.set_learning_rate(self.optimiser, foresight.learning_rate * (1.0 - 0.8 * done))
            commands = torch.as_tensor(env.commands, dtype=torch.float32, device=self.device)
            learned = guide(
                *settings,
                commands,
                foresight.epochs,
                foresight.serious,
                foresight.evenness,
                foresight.steadiness,
                0.0 if foresight.critic_alone else 1.0,
                config,
                self.generator,
                self.peers,
            )
            if self.steps + self.steps_per_iteration >= foresight.steps:
                self.network.set_std(foresight.last_std)
                ppo.set_learning_rate(self.optimiser, config.learning_rate)
            return "guidance", learned
        if teacher is not None:
            return "imitation", imitate(*settings, config, self.config.imitation.weight, self.generator, self.peers)
        return "ppo", ppo.update(*settings, config, self.generator, self.steps / self.config.total_steps, self.peers)

    def _initial_network(self) -> ActorCritic:
        wanted, source = self.config.network_config, self.config.initial_weights
        if source is None:
            return ActorCritic(wanted)
        network, _ = load_safetensors(source)
        if network.config != wanted:
            raise ValueError(f"{source} holds the network {network.config}, expected {wanted}")
        return network

    def _load_teacher(self) -> ActorCritic | None:
        source = self.config.imitation.teacher
        if source is None:
            return None
        teacher, _ = load_safetensors(source)
        told = self.config.network_config.num_people
        require(teacher.config.people == "actor", f"{source}: people", teacher.config.people, "a teacher's 'actor'")
        require(teacher.config.num_people == told, f"{source}: num_people", teacher.config.num_people, str(told))
        return teacher.to(self.device)

    def _teacher_now(self) -> Teacher | None:
        imitation = self.config.imitation
        if self.teacher is None or self.steps >= imitation.steps:
            return None
        return Teacher(self.teacher, imitation.share(self.steps))

    def _scenario(self) -> Scenario:
        return vary_places(self.curriculum.scenario(), self.config.variety.places, self.curriculum.level)

    def _move_worlds(self) -> None:
        scenario = self._scenario()
        for env in self.envs:
            env.scenario = scenario


def _as_arrays(tree: Mapping[str, Any]) -> dict[str, Any]:
    """The same tree without tensors, to be sent to another process."""
    return {
        name: _as_arrays(value)
        if isinstance(value, Mapping)
        else value.cpu().numpy()
        if isinstance(value, torch.Tensor)
        else value
        for name, value in tree.items()
    }


def _episode_means(rollout: Rollout) -> dict[str, float]:
    episodes = rollout.episodes
    means = {"episode/count": float(len(episodes.success))}
    if episodes.success:
        means["episode/return"] = float(np.mean(episodes.total_reward))
        means["episode/length"] = float(np.mean(episodes.length))
        means["episode/success"] = float(np.mean(episodes.success))
        means["episode/collision"] = float(np.mean(episodes.collision))
    return means
