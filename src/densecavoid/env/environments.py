"""The Gymnasium environments, single and vector, thin around the navigation task."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from densecavoid.env.observation import ObserverConfig
from densecavoid.env.privileged import nearest_people
from densecavoid.env.reward import RewardConfig
from densecavoid.env.task import NavigationTask, action_space, observation_space
from densecavoid.frames import PERSON_NUMBERS, Observation
from densecavoid.scenarios import make_scenario
from densecavoid.sim.spec import Scenario
from densecavoid.sim.world import SimConfig


def _as_dict(observation: Observation) -> dict[str, np.ndarray]:
    """A copy that outlasts the observer's buffers."""
    return {name: np.array(value) for name, value in observation._asdict().items()}


class DenseCAvoidVectorEnv(VectorEnv):
    """B environments in one. Ended episodes begin anew in the same step (`AutoresetMode.SAME_STEP`).

    `infos` has, besides Gymnasium's `final_obs` and `_final_obs`: `reward_terms`, a dictionary of [B] arrays; and, in
    steps in which episodes end, `episode` with `return`, `length`, `success`, `collision` and `scenario` of all B
    worlds, valid where `_episode` is true.

    With `true_people`, observations have `people` besides, [B, true_people, 6] (`privileged.nearest_people`).
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        scenario: Scenario | str,
        num_envs: int,
        sim: SimConfig | None = None,
        observer: ObserverConfig | None = None,
        reward: RewardConfig | None = None,
        seed: int = 0,
        data: Path | None = None,
        first_world: int = 0,
        true_people: int = 0,
    ) -> None:
        """Makes the worlds.

        Args:
            scenario, num_envs, sim, observer, reward, seed, first_world: as `NavigationTask`; `scenario` may be a name.
            data: folder of the recordings that a scenario by name needs.
            true_people: how many of the nearest people each observation tells the truth about, for training alone.
        """
        scenario = make_scenario(scenario, data) if isinstance(scenario, str) else scenario
        self.task = NavigationTask(scenario, num_envs, sim, observer, reward, seed, first_world)
        config = self.task.simulator.config
        self.num_envs = num_envs
        self._true_people = true_people
        seen = observation_space(config, self.task.observer.config.num_scans)
        if true_people > 0:
            assert isinstance(seen, gym.spaces.Dict)
            told = gym.spaces.Box(-np.inf, np.inf, (true_people, PERSON_NUMBERS), np.float32)
            seen = gym.spaces.Dict({**seen.spaces, "people": told})
        self.single_observation_space = seen
        self.single_action_space = action_space(config)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._return = np.zeros(num_envs)
        self._length = np.zeros(num_envs, np.int64)

    @property
    def scenario(self) -> Scenario:
        """Where the next episodes are drawn from; may be exchanged at any time."""
        return self.task.simulator.scenario

    @scenario.setter
    def scenario(self, scenario: Scenario) -> None:
        self.task.simulator.scenario = scenario

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begins an episode in every world; a seed begins a new sequence of worlds."""
        if seed is not None:
            self.task.reseed(int(seed if isinstance(seed, int) else seed[0] or 0))
        self._return[:] = 0.0
        self._length[:] = 0
        return self._observed(self.task.reset(np.ones(self.num_envs, np.bool_))), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One control step of every world with actions [B, 2] (m/s, rad/s); outside the space they are clipped."""
        result = self.task.step(np.asarray(actions))
        self._return += result.reward
        self._length += 1
        infos: dict[str, Any] = {"reward_terms": result.terms}
        observation, ended = result.observation, result.terminated | result.truncated
        terminated, truncated = result.terminated.copy(), result.truncated.copy()
        if ended.any():
            sim = self.task.simulator
            final = np.full(self.num_envs, None, dtype=object)
            last = observation._asdict()
            if self._true_people > 0:
                last["people"] = nearest_people(sim, self._true_people)
            for b in np.flatnonzero(ended):
                final[b] = {name: value[b].copy() for name, value in last.items()}
            infos |= {"final_obs": final, "_final_obs": ended, "_episode": ended}
            infos["episode"] = {
                "return": self._return.copy(),
                "length": self._length.copy(),
                "success": sim.succeeded.copy(),
                "collision": sim.collided.copy(),
                "scenario": np.array(sim.scenario_name, dtype=object),
            }
            observation = self.task.reset(ended)
            self._return[ended] = 0.0
            self._length[ended] = 0
        return self._observed(observation), result.reward, terminated, truncated, infos

    def _observed(self, observation: Observation) -> dict[str, np.ndarray]:
        arrays = _as_dict(observation)
        if self._true_people > 0:
            arrays["people"] = nearest_people(self.task.simulator, self._true_people)
        return arrays

    def state_dict(self) -> dict[str, np.ndarray]:
        """Everything that decides how the worlds go on, as arrays; training resumes from it bit for bit."""
        return self.task.state_dict() | {"return": self._return.copy(), "length": self._length.copy()}

    def load_state_dict(self, arrays: dict[str, np.ndarray]) -> None:
        """Goes on from a `state_dict` of an environment made with the same arguments."""
        self.task.load_state_dict(arrays)
        self._return, self._length = np.array(arrays["return"]), np.array(arrays["length"])


class DenseCAvoidEnv(gym.Env):
    """One robot in one world."""

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        scenario: Scenario | str,
        sim: SimConfig | None = None,
        observer: ObserverConfig | None = None,
        reward: RewardConfig | None = None,
        data: Path | None = None,
    ) -> None:
        """See `NavigationTask`; `scenario` may be a name, `data` the folder of recordings it needs."""
        scenario = make_scenario(scenario, data) if isinstance(scenario, str) else scenario
        self.task = NavigationTask(scenario, 1, sim, observer, reward)
        scans = self.task.observer.config.num_scans
        self.observation_space = observation_space(self.task.simulator.config, scans)
        self.action_space = action_space(self.task.simulator.config)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begins the next episode; a seed begins a new sequence of worlds."""
        super().reset(seed=seed)
        if seed is not None:
            self.task.reseed(seed)
        return self._single(self.task.reset(np.ones(1, np.bool_))), {}

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """One control step with (linear m/s, angular rad/s); outside the space it is clipped."""
        result = self.task.step(np.asarray(action)[None])
        sim = self.task.simulator
        info = {
            "reward_terms": {name: float(value[0]) for name, value in result.terms.items()},
            "success": bool(sim.succeeded[0]),
            "collision": bool(sim.collided[0]),
        }
        observation = self._single(result.observation)
        return observation, float(result.reward[0]), bool(result.terminated[0]), bool(result.truncated[0]), info

    @staticmethod
    def _single(observation: Observation) -> dict[str, np.ndarray]:
        return {name: value[0].copy() for name, value in observation._asdict().items()}


def make(scenario: Scenario | str, **kwargs: Any) -> DenseCAvoidEnv:
    """A Gymnasium environment of one robot; arguments as `DenseCAvoidEnv`."""
    return DenseCAvoidEnv(scenario, **kwargs)


def make_vec(scenario: Scenario | str, num_envs: int, **kwargs: Any) -> DenseCAvoidVectorEnv:
    """A Gymnasium vector environment; arguments as `DenseCAvoidVectorEnv`."""
    return DenseCAvoidVectorEnv(scenario, num_envs, **kwargs)
