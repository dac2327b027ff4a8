"""What a training run is told: one frozen dataclass, from which the command line is made. The run folder keeps it."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import torch

from densecavoid.env.reward import RewardConfig
from densecavoid.frames import NUM_SCANS, choose, require
from densecavoid.learning.curriculum import STAGES, CurriculumConfig
from densecavoid.learning.foreseen_worlds import ForesightConfig
from densecavoid.learning.imitation import ImitationConfig
from densecavoid.learning.ppo import PPOConfig
from densecavoid.learning.variety import VarietyConfig
from densecavoid.policy.network import PRESETS, NetworkConfig, preferred_dtype
from densecavoid.policy.sensors import SENSORS
from densecavoid.sim.world import SimConfig


@dataclass(frozen=True)
class TrainConfig:
    """Settings of `densecavoid train`.

    A run is a folder. Ctrl-C saves it; `densecavoid train --resume --run-dir FOLDER` goes on. Several processes train
    one policy with `torchrun --nproc_per_node N -m densecavoid.cli train ...`. More: docs/training.md.
    """

    run_dir: Path = Path("runs/densecavoid")
    """Folder of the run: configuration, logs, checkpoints, policies."""
    name: str = "densecavoid"
    """Name of the policy, as it appears in result tables."""
    stage: Literal["all", "random-goal", "cluttered-static", "random-pedestrians", "dense-random-pedestrians"] = "all"
    """`all` runs the paper's four stages in turn; the name of one trains it alone."""
    network: Literal["compact", "paper", "long2018", "teacher"] = "compact"
    """`compact` (1.4 MFLOP a pass), `paper` (276 MFLOP), `long2018` (lidar alone, 3 MFLOP), or `teacher`, which is
    told where people truly are instead of seeing them (no robot can run it; `imitation` learns from it)."""
    critic: Literal["as-network", "shared", "separate"] = "as-network"
    """Whether actor and critic share the branches that see; as-network: `compact` shares them, `paper` does not."""
    privileged_critic: bool = False
    """Tell the critic, in training alone, where the nearest people truly are and how they move."""
    normalise_inputs: bool = False
    """Bring ranges, goal and velocity to mean 0 and variance 1 by running moments, which the policy's file keeps."""
    normalise_values: bool = False
    """Bring the critic's targets to mean 0 and variance 1 by running moments."""
    sensors: Literal["densecavoid", "depth-lidar", "depth", "lidar"] = "densecavoid"
    """Everything; without the prediction frame; the depth camera alone; the lidar alone."""
    initial_weights: Path | None = None
    """A policy (.safetensors) to start from, such as that of the stage before."""
    num_envs: int = 64
    """Worlds stepped together, by each process."""
    world_groups: int = 0
    """Groups that the worlds of a process are stepped in: with two, one is simulated while the network looks at the
    other. 0 = two with a GPU, one without."""
    steps_per_rollout: int = 64
    """Steps of each world between two updates. 128 needed twice the steps to a first policy."""
    total_steps: int = 5_000_000
    """Environment steps, over all processes, after which the run ends."""
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
    storage: Literal["float16", "float32"] = "float16"
    """How a rollout keeps ranges (2 mm of rounding at 4 m, half the memory); images are bytes in any case."""
    compiled: bool = False
    """Compile the network with torch.compile. On an AVX2 processor an update then took twice as long."""
    noise_persistence: float = 0.0
    """Share of the actions' noise that is kept from one step to the next, in [0, 1): tries go on for longer."""
    averaging: float = 0.0
    """The policy that is given out is the mean over updates, the latest counting most: so much of it is kept at each,
    in [0, 1). Learning goes on with the latest weights; 0 gives those out."""
    checkpoint_every: int = 25
    """Iterations between two checkpoints."""
    remembers: bool = False
    """Show things that the camera saw and may not see any more in place of the oldest scan (`ObserverConfig`)."""
    foretold_s: tuple[float, ...] = ()
    """So far ahead people are shown as further scans (`ObserverConfig`)."""
    route_every_s: float = 0.0
    """So often the way to the goal past what has been seen is looked for, whose next place is then shown for the goal;
    0: the goal itself is shown (`ObserverConfig`)."""
    weighs_commands: bool = False
    """Tell the policy what commands would be worth in what is known around, if people walk on as they do; needs
    `route_every_s` (`ObserverConfig`)."""
    choose_commands: bool = False
    """Let the policy choose among the 25 commands that it is told the worth of (`weighs_commands`): at first what is
    worth most is the likeliest, and learning corrects that. Otherwise it is a Gaussian around a mean."""
    prediction_horizon_s: float = 0.8
    """How far ahead the prediction frame looks."""
    people_from: Literal["boxes", "truth"] = "boxes"
    """Where the prediction frame's people come from: true places with the detector's errors, as a robot will see them,
    or without errors."""
    ppo: PPOConfig = field(default_factory=PPOConfig)
    imitation: ImitationConfig = field(default_factory=ImitationConfig)
    foresight: ForesightConfig = field(default_factory=ForesightConfig)
    variety: VarietyConfig = field(default_factory=VarietyConfig)
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
        choose("critic", self.critic, ("as-network", "shared", "separate"))
        choose("storage", self.storage, ("float16", "float32"))
        require(0 <= self.noise_persistence < 1, "TrainConfig.noise_persistence", self.noise_persistence, "in [0, 1)")
        require(0 <= self.averaging < 1, "TrainConfig.averaging", self.averaging, "in [0, 1)")
        require(
            self.route_every_s == 0 or self.sensors != "depth",
            "TrainConfig.route_every_s",
            self.route_every_s,
            "0 with sensors 'depth': the way is looked for in what the lidar has seen",
        )
        require(
            not self.weighs_commands or self.route_every_s > 0,
            "TrainConfig.weighs_commands",
            self.weighs_commands,
            "false without route_every_s: commands are weighed by the ways that it finds",
        )
        require(
            not self.choose_commands or self.weighs_commands,
            "TrainConfig.choose_commands",
            self.choose_commands,
            "false without weighs_commands",
        )
        require(
            not (self.choose_commands and self.imitation.teacher is not None),
            "TrainConfig.imitation.teacher",
            self.imitation.teacher,
            "none with choose_commands: a teacher's commands lie between those of the grid",
        )
        foreseen = self.foresight.steps > 0
        require(
            not (foreseen and self.imitation.teacher is not None),
            "TrainConfig.imitation.teacher",
            self.imitation.teacher,
            "none together with foresight.steps",
        )
        require(
            not foreseen or (self.sim.people == "scripted" and self.variety.bodies == 0),
            "TrainConfig.foresight.steps",
            self.foresight.steps,
            "0 with people who react, or with variety.bodies: they have no future of their own",
        )
        groups = self.num_groups
        require(self.num_envs % groups == 0, "TrainConfig.num_envs", self.num_envs, f"a multiple of {groups} groups")
        for name in ("num_envs", "steps_per_rollout", "total_steps", "checkpoint_every"):
            require(getattr(self, name) > 0, f"TrainConfig.{name}", getattr(self, name), "positive")
        for name in ("max_minutes", "threads", "seed", "world_groups"):
            require(getattr(self, name) >= 0, f"TrainConfig.{name}", getattr(self, name), "0 or more")

    @property
    def stages(self) -> tuple[str, ...]:
        """The stages that will run, in order."""
        return STAGES if self.stage == "all" else (self.stage,)

    @property
    def torch_device(self) -> torch.device:
        """The device that `device` means on this machine, for this process."""
        kind = self.device
        if kind == "auto":
            kind = "cuda" if torch.cuda.is_available() else "cpu"
        return torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0"))) if kind == "cuda" else torch.device("cpu")

    @property
    def num_groups(self) -> int:
        """The groups of worlds that `world_groups` means on this machine; never fewer than there are bodies."""
        groups = self.world_groups or (2 if self.torch_device.type == "cuda" else 1)
        return max(groups, self.variety.bodies)

    @property
    def network_config(self) -> NetworkConfig:
        """The network that these settings ask for."""
        robot, config = self.sim.robot, NetworkConfig.preset(self.network)
        if self.critic != "as-network":
            config = replace(config, shared_encoder=self.critic == "shared")
        if self.privileged_critic and config.people == "unseen":
            config = replace(config, people="critic")
        return replace(
            config.with_robot(robot.max_linear_velocity, robot.max_angular_velocity),
            num_scans=NUM_SCANS + len(self.foretold_s),
            worth_features=64 if self.weighs_commands else 0,
            chooses=self.choose_commands,
            normalise_inputs=self.normalise_inputs or config.normalise_inputs,
            normalise_values=self.normalise_values or config.normalise_values,
        )

    @property
    def torch_dtype(self) -> torch.dtype:
        """The arithmetic that `precision` means on this machine."""
        if self.precision == "auto":
            return preferred_dtype(self.torch_device)
        return torch.bfloat16 if self.precision == "bfloat16" else torch.float32
