"""What the policy's networks are made of: layers, sizes and switches, as frozen configurations. No torch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from densecavoid.frames import COMMAND_GRID, NUM_SCANS, PERSON_NUMBERS, choose, require

WORTH_SCALES = (0.004, 0.03, 0.2)
"""Losses against the best command that are told apart: a moment's delay, some seconds', a collision."""


@dataclass(frozen=True)
class ConvConfig:
    """One convolution followed by ReLU. Where kernel and stride are equal the windows do not overlap and there is no
    padding; otherwise it is padded so that the output has ceil(input / stride) places (SAME).
    """

    filters: int
    kernel: tuple[int, ...]
    stride: tuple[int, ...]

    def __post_init__(self) -> None:
        require(self.filters > 0, "ConvConfig.filters", self.filters, "positive")
        require(min(self.kernel + self.stride) > 0, "ConvConfig", (self.kernel, self.stride), "positive sizes")
        require(
            len(self.kernel) == len(self.stride), "ConvConfig.stride", self.stride, "as many sizes as the kernel has"
        )
        require(
            self.is_patch or all(size % 2 == 1 for size in self.kernel),
            "ConvConfig.kernel",
            self.kernel,
            "odd sizes, or sizes equal to the stride",
        )

    @property
    def is_patch(self) -> bool:
        """Whether the windows do not overlap, which makes the convolution one matrix product."""
        return self.kernel == self.stride

    @property
    def padding(self) -> tuple[int, ...]:
        return tuple(0 if self.is_patch else (size - 1) // 2 for size in self.kernel)

    def output_size(self, size: Sequence[int]) -> tuple[int, ...]:
        """Places along each axis after this layer."""
        if self.is_patch:
            for length, window in zip(size, self.kernel, strict=True):
                require(
                    length % window == 0, "ConvConfig.kernel", self.kernel, f"a divisor of the input size {tuple(size)}"
                )
        return tuple(-(-length // stride) for length, stride in zip(size, self.stride, strict=True))


@dataclass(frozen=True)
class NetworkConfig:
    """What the network is made of. `NetworkConfig.preset(name)` gives the named ones."""

    name: str
    lidar_layers: tuple[ConvConfig, ...]
    lidar_features: tuple[int, ...]
    """Sizes of the fully connected layers behind the lidar's convolutions."""
    camera_layers: tuple[ConvConfig, ...]
    camera_features: tuple[int, ...]
    head_features: int
    """Size of the fully connected layer behind the joined branches, one for the actor and one for the critic."""
    goal_direction: bool
    """Whether the goal's bearing is given as cosine and sine, continuous all around, or raw as in the paper."""
    lidar_falloff: float
    """Ranges r (fractions of the greatest) are given as exp(-lidar_falloff r), so that free space is near 0 and what
    is close stands out; with 0 raw, as in the paper."""
    state_gain: float
    """Goal and velocity are multiplied by it, so that these few numbers are heard beside hundreds of features of the
    sensors: with raw ranges, 4 took .1 M steps to the first goals instead of .16 M (three seeds each)."""
    shared_encoder: bool
    """Whether actor and critic read the same branches (one pass) or each has its own."""
    num_scans: int = NUM_SCANS
    """Scans in an observation: consecutive ones, and those that foretell people (`ObserverConfig.foretold_s`)."""
    worth_features: int = 0
    """Size of the fully connected layer behind what commands are worth (`ObserverConfig.weighs_commands`); 0: it is
    not looked at."""
    chooses: bool = False
    """Whether the policy chooses among `COMMAND_GRID`, knowing what each is worth, or is a Gaussian around a mean."""
    indifference: float = 0.003
    """By so much less worth a command is e times less likely to be chosen, before the network corrects that."""
    num_rays: int = 512
    image_size: tuple[int, int] = (60, 80)
    """Height and width of depth image and prediction frame, pixels."""
    max_linear_velocity: float = 1.0
    """m/s; the mean lies in (0, max)."""
    max_angular_velocity: float = 0.4
    """rad/s; the mean lies in (-max, max)."""
    initial_std: tuple[float, float] = (0.4, 0.3)
    """Standard deviations of v (m/s) and w (rad/s) before training."""
    min_std: tuple[float, float] = (0.12, 0.12)
    """The floor that training keeps them above (m/s, rad/s): a policy that no longer tries anything once it reaches
    goals in an empty world learns to avoid obstacles several times more slowly."""
    people: Literal["unseen", "critic", "actor"] = "unseen"
    """Who is told the truth about the nearest people, in training alone: nobody, a privileged critic, or actor and
    critic (a teacher, which no robot can run)."""
    num_people: int = 8
    """How many of them."""
    people_features: int = 64
    """Size of the two layers that each true person passes before the greatest of each feature is taken."""
    normalise_inputs: bool = False
    """Whether ranges, goal and velocity are brought to mean 0 and variance 1 by running moments kept in the weights."""
    normalise_values: bool = False
    """Whether the critic learns returns brought to mean 0 and variance 1 by running moments kept in the weights."""

    def __post_init__(self) -> None:
        for name in ("num_rays", "head_features", "state_gain", "max_linear_velocity", "max_angular_velocity"):
            require(getattr(self, name) > 0, f"NetworkConfig.{name}", getattr(self, name), "positive")
        require(self.num_scans >= NUM_SCANS, "NetworkConfig.num_scans", self.num_scans, f"at least {NUM_SCANS}")
        require(self.worth_features >= 0, "NetworkConfig.worth_features", self.worth_features, "0 or more")
        require(not self.chooses or self.worth_features > 0, "NetworkConfig.worth_features", 0, "positive to choose")
        require(self.indifference > 0, "NetworkConfig.indifference", self.indifference, "positive")
        for name in ("num_people", "people_features"):
            require(getattr(self, name) > 0, f"NetworkConfig.{name}", getattr(self, name), "positive")
        choose("NetworkConfig.people", self.people, ("unseen", "critic", "actor"))
        for name in ("lidar_layers", "lidar_features"):
            require(len(getattr(self, name)) > 0, f"NetworkConfig.{name}", getattr(self, name), "at least one layer")
        camera = (len(self.camera_layers), len(self.camera_features))
        require(min(camera) > 0 or camera == (0, 0), "NetworkConfig camera layers", camera, "some of both or none")
        for initial, floor in zip(self.initial_std, self.min_std, strict=True):
            require(
                0 < floor <= initial, "NetworkConfig.min_std", self.min_std, f"positive, at most {self.initial_std}"
            )
        self.branch_sizes()

    @staticmethod
    def preset(name: str) -> NetworkConfig:
        """`compact` (shared branches, about 1.4 MFLOP a pass), `paper` (published Fig. 3, 276 MFLOP), `long2018` (the
        lidar alone, 3 MFLOP, as in Long et al. 2018, Towards optimally decentralized multi-robot collision avoidance),
        or `teacher` (is told of true people instead of a camera's image, .2 MFLOP, for imitation).

        Raises:
            ValueError: if there is no preset of this name.
        """
        return PRESETS[choose("network", name, tuple(PRESETS))]

    @property
    def num_goal_features(self) -> int:
        """Distance, and the bearing as one number or as two."""
        return 3 if self.goal_direction else 2

    @property
    def num_state_features(self) -> int:
        """Goal and velocity."""
        return self.num_goal_features + 2

    @property
    def num_worth_inputs(self) -> int:
        """The worth of each command, and how far behind the best it is on each of `WORTH_SCALES`."""
        return (1 + len(WORTH_SCALES)) * len(COMMAND_GRID)

    @property
    def privileged(self) -> bool:
        """Whether training needs to be told the truth about people."""
        return self.people != "unseen"

    def with_robot(self, max_linear_velocity: float, max_angular_velocity: float) -> NetworkConfig:
        """A copy for a robot with other limits (m/s, rad/s)."""
        return replace(self, max_linear_velocity=max_linear_velocity, max_angular_velocity=max_angular_velocity)

    def branch_sizes(self) -> tuple[list[tuple[int, ...]], list[tuple[int, ...]]]:
        """Places along each axis after every convolution: lidar [(places,)], camera [(rows, columns)]."""
        lidar: list[tuple[int, ...]] = [(self.num_rays,)]
        for layer in self.lidar_layers:
            lidar.append(layer.output_size(lidar[-1]))
        camera: list[tuple[int, ...]] = [self.image_size]
        for layer in self.camera_layers:
            camera.append(layer.output_size(camera[-1]))
        return lidar[1:], camera[1:]


PRESETS = {
    "paper": NetworkConfig(
        name="paper",
        lidar_layers=(ConvConfig(32, (5,), (2,)), ConvConfig(16, (3,), (2,))),
        lidar_features=(256,),
        camera_layers=(ConvConfig(64, (5, 5), (2, 2)), ConvConfig(64, (5, 5), (1, 1)), ConvConfig(32, (3, 3), (2, 2))),
        camera_features=(512, 256),
        head_features=128,
        goal_direction=False,
        lidar_falloff=0.0,
        state_gain=1.0,
        shared_encoder=False,
    ),
    "compact": NetworkConfig(
        name="compact",
        lidar_layers=(ConvConfig(32, (8,), (8,)), ConvConfig(32, (2,), (2,))),
        lidar_features=(128,),
        camera_layers=(ConvConfig(16, (4, 4), (4, 4)), ConvConfig(32, (3, 4), (3, 4))),
        camera_features=(128,),
        head_features=128,
        goal_direction=True,
        lidar_falloff=4.0,
        state_gain=2.0,
        shared_encoder=True,
    ),
    "long2018": NetworkConfig(
        name="long2018",
        lidar_layers=(ConvConfig(32, (5,), (2,)), ConvConfig(32, (3,), (2,))),
        lidar_features=(256,),
        camera_layers=(),
        camera_features=(),
        head_features=128,
        goal_direction=False,
        lidar_falloff=0.0,
        state_gain=1.0,
        shared_encoder=False,
    ),
    "teacher": NetworkConfig(
        name="teacher",
        lidar_layers=(ConvConfig(16, (16,), (16,)),),
        lidar_features=(64,),
        camera_layers=(),
        camera_features=(),
        head_features=64,
        goal_direction=True,
        lidar_falloff=4.0,
        state_gain=2.0,
        shared_encoder=True,
        people="actor",
    ),
}


def count_mflop(config: NetworkConfig) -> float:
    """Million floating-point operations of one pass of what the robot runs; a multiplication with its addition is 2."""
    lidar_sizes, camera_sizes = config.branch_sizes()
    operations, joined = 0, config.num_state_features
    for channels, layers, sizes, features in (
        (config.num_scans, config.lidar_layers, lidar_sizes, config.lidar_features),
        (2, config.camera_layers, camera_sizes, config.camera_features),
    ):
        for layer, size in zip(layers, sizes, strict=True):
            operations += 2 * channels * math.prod(layer.kernel) * layer.filters * math.prod(size)
            channels = layer.filters
        if not layers:
            continue
        inputs = channels * math.prod(sizes[-1])
        for outputs in features:
            operations += 2 * inputs * outputs
            inputs = outputs
        joined += inputs
    if config.worth_features:
        operations += 2 * config.num_worth_inputs * config.worth_features
        joined += config.worth_features
    if config.people == "actor":
        width = config.people_features
        operations += 2 * config.num_people * width * (PERSON_NUMBERS + width)
        joined += width
    outputs = len(COMMAND_GRID) if config.chooses else 2
    return (operations + 2 * config.head_features * (joined + outputs)) / 1e6
