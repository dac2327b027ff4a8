"""What a training run is told: one frozen dataclass, from which the command line is made. The run folder keeps it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import torch

from densecavoid.env.reward import RewardConfig
from densecavoid.frames import choose, require
from densecavoid.learning.curriculum import STAGES, CurriculumConfig
from densecavoid.learning.ppo import PPOConfig
from densecavoid.policy.network import PRESETS, preferred_dtype
from densecavoid.policy.sensors import SENSORS
from densecavoid.sim.world import SimConfig


@dataclass(frozen=True)
class TrainConfig:
    """Settings of `densecavoid train`."""

    run_dir: Path = Path("runs/densecavoid")
    """Folder of the run: configuration, logs, checkpoints, policies."""
    name: str = "densecavoid"
    """Name of the policy, as it appears in result tables."""
    stage: Literal["all", "random-goal", "cluttered-static", "random-pedestrians", "dense-random-pedestrians"] = "all"
    """`all` runs the paper's four stages in turn; the name of one trains it alone."""
    network: Literal["compact", "paper"] = "compact"
    """`compact` (1.4 MFLOP a pass) or `paper` (276 MFLOP)."""
    sensors: Literal["densecavoid", "depth-lidar", "depth"] = "densecavoid"
    """Everything; without the prediction frame; the depth camera alone."""
    initial_weights: Path | None = None
    """A policy (.safetensors) to start from, such as that of the stage before."""
    num_envs: int = 64
    """Worlds stepped together."""
    steps_per_rollout: int = 64
    """Steps of each world between two updates. 128 needed twice the steps to a first policy."""
    total_steps: int = 5_000_000
    """Environment steps after which the run ends."""
    max_minutes: float = 0.0
    """Minutes after which it ends all the same; 0 = no limit."""
    seed: int = 0
    """Of weights, worlds, actions and shuffling."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where the network lives; `auto` takes the GPU if there is one."""
    precision: Literal["auto", "float32", "bfloat16"] = "auto"
    """Arithmetic of the network's branches; `auto` takes bfloat16 where the processor multiplies it natively."""
    threads: int = 0
    """Threads of torch; 0 = all cores. (Those of the simulator: sim.threads.)"""
    checkpoint_every: int = 25
    """Iterations between two checkpoints."""
    prediction_horizon_s: float = 0.8
    """How far ahead the prediction frame looks."""
    people_from: Literal["boxes", "truth"] = "boxes"
    """Where the prediction frame's people come from: true places with the detector's errors, as a robot will see them,
    or without errors."""
    ppo: PPOConfig = field(default_factory=PPOConfig)
    curriculum: CurriculumConfig = field(default_factory=CurriculumConfig)
    sim: SimConfig = field(default_factory=SimConfig)
    reward: RewardConfig = field(default_factory=RewardConfig)

    def __post_init__(self) -> None:
        choose("stage", self.stage, ("all", *STAGES))
        choose("network", self.network, tuple(PRESETS))
        choose("sensor configuration", self.sensors, SENSORS)
        choose("people_from", self.people_from, ("boxes", "truth"))
        choose("device", self.device, ("auto", "cpu", "cuda"))
        choose("precision", self.precision, ("auto", "float32", "bfloat16"))
        for name in ("num_envs", "steps_per_rollout", "total_steps", "checkpoint_every"):
            require(getattr(self, name) > 0, f"TrainConfig.{name}", getattr(self, name), "positive")
        for name in ("max_minutes", "threads", "seed"):
            require(getattr(self, name) >= 0, f"TrainConfig.{name}", getattr(self, name), "0 or more")

    @property
    def stages(self) -> tuple[str, ...]:
        """The stages that will run, in order."""
        return STAGES if self.stage == "all" else (self.stage,)

    @property
    def torch_device(self) -> torch.device:
        """The device that `device` means on this machine."""
        if self.device == "auto":
            return torch.device("cuda" if torch.cuda.is_available() else "cpu")
        return torch.device(self.device)

    @property
    def torch_dtype(self) -> torch.dtype:
        """The arithmetic that `precision` means on this machine."""
        if self.precision == "auto":
            return preferred_dtype(self.torch_device)
        return torch.bfloat16 if self.precision == "bfloat16" else torch.float32
