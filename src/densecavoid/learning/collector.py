"""The loop that fills a rollout from Gymnasium vector environments with SAME_STEP autoreset. No learning here.

The worlds come in groups. With two or more, one group's step runs on the cores while the network looks at another's
observations. Draws are made for the worlds of all processes at once, and each takes its own: what a world meets does
not depend on how worlds are spread over groups and processes.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from torch import Tensor

from densecavoid.frames import Observation, require
from densecavoid.learning.peers import Peers
from densecavoid.learning.rollout import Episodes, Rollout
from densecavoid.policy.network import ActorCritic, ObservationTensors
from densecavoid.policy.sensors import mask_observation

StepResult = tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]


@dataclass(frozen=True)
class Teacher:
    """Who shows the policy what to do, and in what share of the steps it drives instead (DAgger: Ross et al. 2011)."""

    network: ActorCritic
    share: float


@dataclass
class Seen:
    """The latest observation of one group. The arrays are its own."""

    observation: Observation
    people: np.ndarray | None
    command_values: np.ndarray | None = None


class Collector:
    """Steps the worlds with the current policy. Owns the latest observations, so rollouts leave no gap."""

    def __init__(
        self,
        envs: Sequence[VectorEnv],
        num_steps: int,
        sensors: str,
        reward_scale: float,
        device: torch.device,
        *,
        peers: Peers = Peers(),  # noqa: B008
        lidar_dtype: torch.dtype = torch.float32,
    ) -> None:
        """
        Args:
            envs: groups of worlds; every process has as many worlds.
            num_steps: T, steps of each world a rollout.
            sensors: what is seen, one of `policy.sensors.SENSORS`.
            reward_scale: rewards are multiplied by it.
            device: where the network and the rollout live.
            peers: the processes that train together.
            lidar_dtype: how ranges are stored; float16 halves them (2 mm at 4 m).
        """
        for env in envs:
            mode = env.metadata.get("autoreset_mode")
            require(
                mode == AutoresetMode.SAME_STEP, "the environment's autoreset_mode", mode, "AutoresetMode.SAME_STEP"
            )
        require(len(envs) > 0, "environments", list(envs), "at least one")
        self.envs = tuple(envs)
        self.num_steps = num_steps
        self.sensors = sensors
        self.reward_scale = reward_scale
        self.device = device
        self.peers = peers
        self.lidar_dtype = lidar_dtype
        bounds = np.cumsum([0, *(env.num_envs for env in envs)]).tolist()
        self.num_worlds = bounds[-1]
        self.first_world = peers.rank * self.num_worlds
        self.slices = [slice(first, stop) for first, stop in itertools.pairwise(bounds)]
        self.seen: list[Seen] = []
        self.noise: Tensor | None = None
        self._storage: Rollout | None = None
        self._staging: list[list[Tensor]] = []
        self._worker = ThreadPoolExecutor(1, "densecavoid-worlds") if len(envs) > 1 else None

    def reset(self, seed: int) -> None:
        """Start all worlds afresh."""
        self.seen = [self._seen(env.reset(seed=seed)[0]) for env in self.envs]
        self.noise = None

    def collect(
        self,
        network: ActorCritic,
        generator: torch.Generator,
        on_step: Callable[[], None] = lambda: None,
        teacher: Teacher | None = None,
        noise_persistence: float = 0.0,
    ) -> Rollout:
        """One rollout. The tensors returned are reused by the next call.

        Args:
            network: acts and values; not changed.
            generator: source of the actions' noise, on the collector's device, in the same state in all processes.
            on_step: called after each step of all worlds, for progress.
            teacher: is asked in every step, and drives in some.
            noise_persistence: share of the actions' noise that is kept from step to step, in [0, 1).

        Raises:
            PeerLostError: if another process is gone.
        """
        if not self.seen:
            raise RuntimeError("Collector.reset must be called before Collector.collect")
        rollout = self._begin(teacher)
        finals = _Finals()
        terms: dict[str, float] = {}
        pending: list[Callable[[], StepResult]] = []
        with torch.no_grad():
            for t in range(self.num_steps):
                noise, driven = self._draw(generator, teacher, noise_persistence)
                for g, part in enumerate(self.slices):
                    if t > 0:
                        self._record(rollout, t - 1, g, pending[g](), terms, finals)
                    action = self._act(network, rollout, t, g, noise[part], teacher, driven[part])
                    started = self._start(g, action)
                    pending[g : g + 1] = [started]
                on_step()
            for g in range(len(self.envs)):
                self._record(rollout, self.num_steps - 1, g, pending[g](), terms, finals)
            rollout.next_value[:-1] = rollout.value[1:]
            for part, seen in zip(self.slices, self.seen, strict=True):
                rollout.next_value[-1, part] = network.value(*self._to_device(seen))
            if finals.places:
                index = tuple(torch.tensor(axis, device=self.device) for axis in zip(*finals.places, strict=True))
                rollout.next_value[index] = network.value(*self._to_device(finals.joined()))
        rollout.episodes = Episodes.joined(self.peers.gather(rollout.episodes))
        everybody = self.peers.gather(terms)
        steps = self.num_steps * self.num_worlds * self.peers.count
        rollout.reward_terms = {name: sum(each[name] for each in everybody) / steps for name in terms}
        return rollout

    def state_dict(self) -> dict[str, Any]:
        """The latest observations of this process' worlds and the lasting noise of all worlds."""
        seen = {}
        for g, s in enumerate(self.seen):
            told = {"people": s.people, "command_values": s.command_values}
            seen[str(g)] = s.observation._asdict() | {name: array for name, array in told.items() if array is not None}
        return {"seen": seen, "noise": {} if self.noise is None else {"last": self.noise}}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes on from a `state_dict`."""
        self.seen = []
        for g in range(len(self.envs)):
            arrays = dict(state["seen"][str(g)])
            people, worth = arrays.pop("people", None), arrays.pop("command_values", None)
            self.seen.append(Seen(Observation(**arrays), people, worth))
        noise = state["noise"].get("last")
        self.noise = None if noise is None else torch.as_tensor(np.asarray(noise), device=self.device)

    def close(self) -> None:
        """Ends the thread that steps worlds; the environments are their maker's to close."""
        if self._worker is not None:
            self._worker.shutdown()

    # -- inside --------------------------------------------------------------------------------------------------------

    def _begin(self, teacher: Teacher | None) -> Rollout:
        if self._storage is None:
            arrays = zip(*(seen.observation for seen in self.seen), strict=True)
            example = Observation(*(np.concatenate(parts) for parts in arrays))
            told = [seen.people for seen in self.seen if seen.people is not None]
            people = np.concatenate(told) if told else None
            self._storage = Rollout.allocate(self.num_steps, example, people, self.device, self.lidar_dtype)
            worth = self.seen[0].command_values
            if worth is not None:
                shape = (self.num_steps, self.num_worlds, worth.shape[1])
                self._storage.command_values = torch.zeros(shape, device=self.device)
            if self.device.type == "cuda":
                stored = [*self._storage.observation]
                self._staging = [
                    [torch.empty_like(x[0, part], device="cpu", pin_memory=True) for x in stored]
                    for part in self.slices
                ]
        rollout = self._storage
        rollout.episodes = Episodes()
        rollout.teacher_mean = None if teacher is None else torch.zeros_like(rollout.action)
        return rollout

    def _draw(self, generator: torch.Generator, teacher: Teacher | None, kept: float) -> tuple[Tensor, Tensor]:
        """Noise of the actions [N, 2], and where the teacher drives [N]; drawn for all processes' worlds."""
        total, own = self.num_worlds * self.peers.count, slice(self.first_world, self.first_world + self.num_worlds)
        fresh = torch.randn(total, 2, generator=generator, device=self.device)
        self.noise = fresh if self.noise is None else kept * self.noise + math.sqrt(1 - kept * kept) * fresh
        driven = torch.zeros(total, dtype=torch.bool, device=self.device)
        if teacher is not None:
            driven = torch.rand(total, generator=generator, device=self.device) < teacher.share
        return self.noise[own], driven[own]

    def _act(
        self,
        network: ActorCritic,
        rollout: Rollout,
        t: int,
        g: int,
        noise: Tensor,
        teacher: Teacher | None,
        driven: Tensor,
    ) -> np.ndarray:
        part, seen = self.slices[g], self.seen[g]
        for i, (stored, array) in enumerate(zip(rollout.observation, seen.observation, strict=True)):
            source = torch.from_numpy(array)
            if self._staging:
                source = self._staging[g][i].copy_(source)
            stored[t, part].copy_(source, non_blocking=True)
        people = None
        if rollout.people is not None and seen.people is not None:
            rollout.people[t, part].copy_(torch.from_numpy(seen.people))
            people = rollout.people[t, part]
        if rollout.command_values is not None and seen.command_values is not None:
            rollout.command_values[t, part].copy_(torch.from_numpy(seen.command_values))
        observation = ObservationTensors(*(stored[t, part] for stored in rollout.observation))
        output = network(observation, people)
        action = output.policy.at(noise)
        if teacher is not None and rollout.teacher_mean is not None:
            shown = teacher.network.command(observation, people)
            rollout.teacher_mean[t, part] = shown
            action = torch.where(driven[:, None], shown, action)
        rollout.action[t, part] = action
        rollout.log_prob[t, part] = output.policy.log_prob(action)
        rollout.value[t, part] = output.value
        return action.cpu().numpy()

    def _start(self, g: int, action: np.ndarray) -> Callable[[], StepResult]:
        """Begins a step of group g; the call returned waits for its result."""
        if self._worker is None:
            result = self.envs[g].step(action)
            return lambda: result  # type: ignore[return-value]
        future: Future[Any] = self._worker.submit(self.envs[g].step, action)
        return future.result

    def _record(
        self, rollout: Rollout, t: int, g: int, result: StepResult, terms: dict[str, float], finals: _Finals
    ) -> None:
        part = self.slices[g]
        observation, reward, terminated, truncated, infos = result
        scaled = torch.from_numpy(np.asarray(reward, dtype=np.float32)) * self.reward_scale
        for stored, values in (
            (rollout.reward, scaled),
            (rollout.terminated, torch.from_numpy(np.asarray(terminated))),
            (rollout.truncated, torch.from_numpy(np.asarray(truncated))),
        ):
            stored[t, part].copy_(values)
        for name, values in infos.get("reward_terms", {}).items():
            terms[name] = terms.get(name, 0.0) + float(np.sum(values))
        for n in np.flatnonzero(truncated & ~terminated):
            last = {name: np.asarray(array)[None] for name, array in infos["final_obs"][n].items()}
            finals.add(t, part.start + int(n), self._seen(last))
        rollout.episodes.record(t, self.first_world + part.start, infos)
        self.seen[g] = self._seen(observation)

    def _seen(self, observation: dict[str, np.ndarray]) -> Seen:
        """As the sensor configuration sees it."""
        arrays = Observation(*(np.asarray(observation[name]) for name in Observation._fields))
        masked = mask_observation(arrays, self.sensors)
        return Seen(masked, observation.get("people"), observation.get("command_values"))

    def _to_device(self, seen: Seen) -> tuple[ObservationTensors, Tensor | None]:
        tensors = ObservationTensors(*(torch.from_numpy(array).to(self.device) for array in seen.observation))
        # As the rollout stores them, so that a value does not depend on where it is computed.
        tensors = tensors._replace(lidar=tensors.lidar.to(self.lidar_dtype))
        return tensors, None if seen.people is None else torch.from_numpy(seen.people).to(self.device)


class _Finals:
    """Observations in which the clock stopped, whose values the rollout still needs."""

    def __init__(self) -> None:
        self.places: list[tuple[int, int]] = []
        self._seen: list[Seen] = []

    def add(self, step: int, world: int, seen: Seen) -> None:
        self.places.append((step, world))
        self._seen.append(seen)

    def joined(self) -> Seen:
        observations = zip(*(seen.observation for seen in self._seen), strict=True)
        told = [seen.people for seen in self._seen if seen.people is not None]
        return Seen(
            Observation(*(np.concatenate(arrays) for arrays in observations)), np.concatenate(told) if told else None
        )
