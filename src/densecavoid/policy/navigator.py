"""DenseCAvoid as a navigator: sensors -> observation -> policy -> command. No torch, no safety filter (`safety`)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool

from densecavoid.env.observation import Observer, ObserverConfig
from densecavoid.frames import Command, Observation, RobotConfig, SensorFrame, require
from densecavoid.networks.config_json import from_dict
from densecavoid.perception.config import PeopleFrom
from densecavoid.perception.networks import PeopleNetworks
from densecavoid.perception.predictor.contract import Predictor
from densecavoid.perception.tracks import Tracks
from densecavoid.policy.card import PolicyCard
from densecavoid.policy.folder import open_folder
from densecavoid.policy.noise import EpisodeNoise
from densecavoid.policy.runtime import POLICIES, OnnxPolicy
from densecavoid.policy.sensors import mask_observation


@runtime_checkable
class Policy(Protocol):
    """What acts: an `OnnxPolicy`, or another trainer's network beside a card."""

    card: PolicyCard

    def __call__(self, observation: Observation, noise: np.ndarray | None = None) -> np.ndarray:
        """The likeliest command (v m/s, w rad/s) of each row [B, 2], or the draw that standard normal noise makes."""
        ...


class PolicyNavigator:
    """Satisfies `frames.Navigator`. Owns the observer's memory of each world (earlier scans, tracks)."""

    def __init__(
        self,
        policy: Policy,
        *,
        people_from: PeopleFrom = "detector",
        sample: bool | None = None,
        seed: int = 0,
        num_worlds: int = 1,
        networks: PeopleNetworks = PeopleNetworks(),
        robot: RobotConfig | None = None,
    ) -> None:
        """
        Args:
            policy: what acts; its file says how observations are made.
            people_from: where people's places come from, whatever it was in training: the robot's own sensors, or, to
                compare with, ground truth. Policies that do not see the prediction frame need none.
            sample: draw from the policy, as in the paper's equation, instead of doing what is likeliest. None: as it
                drives best: who chooses among commands draws (where two are about as good, the likeliest is one now and
                the other a tenth of a second later, and the robot stays where it is), others act with the mean.
            seed: of the draws, which are made from the same numbers in every episode.
            num_worlds: batch size until the first `reset`.
            networks: who finds and foresees people.
            robot: whom it drives; the robot of its training unless given. A policy that is told what commands are
                worth (`ObserverConfig.weighs_commands`) is told it for this robot's limits, where they are lower, and
                velocities mean the same shares of them. Other policies' commands are cut.

        Raises:
            ValueError: for a policy whose file contradicts itself.
        """
        self.policy = policy
        uses_people = policy.card.sensors == "densecavoid"
        self.people_from: PeopleFrom = people_from if uses_people else "nothing"
        self.name = policy.card.name + (f":{people_from}" if uses_people and people_from != "detector" else "")
        self._observer_config = read_observer_config(policy.card.observation, self.people_from)
        require(
            self._observer_config.weighs_commands or not policy.card.network.get("worth_features"),
            f"weighs_commands in the card of policy {policy.card.name!r}",
            False,
            "true: its network looks at what commands are worth",
        )
        trained = np.array([policy.card.max_linear_velocity, policy.card.max_angular_velocity], np.float32)
        self._limits, self._shares = trained, np.ones(2, np.float32)
        if robot is not None:
            of_robot = np.array([robot.max_linear_velocity, robot.max_angular_velocity], np.float32)
            self._limits = np.minimum(of_robot, trained)
            linear, angular = map(float, self._limits)
            robot = dataclasses.replace(robot, max_linear_velocity=linear, max_angular_velocity=angular)
            self._observer_config = dataclasses.replace(self._observer_config, robot=robot)
            if self._observer_config.weighs_commands:
                self._shares = self._limits / trained
        self._networks = networks
        self._observer = Observer(self._observer_config, num_worlds, networks)
        self._num_worlds = num_worlds
        self.observation: Observation | None = None
        """What it acted on last, in buffers that the next act writes again."""
        draws = policy.card.chooses if sample is None else sample
        self._noise = EpisodeNoise(seed, num_worlds) if draws else None
        self.noise: np.ndarray | None = None
        """What the last command was drawn with; none if it is the likeliest."""

    @property
    def privileged(self) -> bool:
        """Whether it reads ground truth."""
        return self._observer.privileged

    @property
    def observer_config(self) -> ObserverConfig:
        """What it must be given to see."""
        return self._observer_config

    @property
    def tracks(self) -> Tracks:
        """Everybody tracked now."""
        return self._observer.tracks

    @property
    def predictor(self) -> Predictor:
        """Who says where they will be."""
        return self._observer.people.predictor

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Forget the episodes of the marked worlds; another length than before starts all of them afresh."""
        if len(which) != self._num_worlds:
            self._num_worlds = len(which)
            self._observer = Observer(self._observer_config, self._num_worlds, self._networks)
        else:
            self._observer.reset(which)
        if self._noise is not None:
            self._noise.reset(which)

    def act(self, frame: SensorFrame) -> Command:
        """The command for each world, within the robot's limits.

        Raises:
            ValueError: if the frame has another number of worlds than `reset` announced.
        """
        if frame.num_worlds != self._num_worlds:
            raise ValueError(
                f"the frame has {frame.num_worlds} worlds, expected {self._num_worlds} as in the last reset"
            )
        observation = mask_observation(self._observer.observe(frame), self.policy.card.sensors)
        observation = self.observation = observation._replace(velocity=observation.velocity / self._shares)
        self.noise = None if self._noise is None else self._noise.next()
        command = self.policy(observation, self.noise) * self._shares
        command = np.clip(command, [0.0, -self._limits[1]], self._limits).astype(np.float32)
        return Command(command[:, 0], command[:, 1])


def read_observer_config(values: Mapping[str, Any], people_from: PeopleFrom) -> ObserverConfig:
    """The configuration in a policy's file, with another source of people's places.

    Raises:
        ValueError: for what is no such configuration.
    """
    values = dict(values)
    if "horizon_s" in values:  # the first policies had a single horizon
        values["horizons_s"] = [values.pop("horizon_s")]
    return dataclasses.replace(from_dict(ObserverConfig, values), people_from=people_from)


def load_policy(
    name_or_path: str | Path, *, people_from: PeopleFrom = "detector", sample: bool | None = None, seed: int = 0
) -> PolicyNavigator:
    """The navigator of a shipped policy (by name), of an ONNX file, or of an exported folder with all that is in it.

    Other arguments as `PolicyNavigator`.

    Raises:
        FileNotFoundError: if there is no such policy.
        ValueError: if the file is not a policy of this project, there is no detector for its camera, or a file of the
            folder is missing or was changed.
    """
    # A folder that happens to be called like a shipped policy is not meant.
    if Path(name_or_path).is_dir() and str(name_or_path) not in POLICIES.names():
        _, policy, networks = open_folder(Path(name_or_path))
    else:
        policy, networks = OnnxPolicy(name_or_path), PeopleNetworks()
    return PolicyNavigator(policy, people_from=people_from, sample=sample, seed=seed, networks=networks)
