"""What a weights file says about itself, in safetensors as in ONNX. No torch: the runtime reads it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from densecavoid.frames import choose, require
from densecavoid.networks.config_json import read_card, to_json
from densecavoid.policy.sensors import SENSORS

METADATA_KEY = "densecavoid.policy"
CARD_FORMAT = 1


@dataclass(frozen=True)
class PolicyCard:
    """Everything that must agree between training and the robot."""

    name: str
    sensors: str
    """One of `SENSORS`: what the policy was trained to see."""
    network: dict[str, Any]
    """`NetworkConfig`, as JSON."""
    observation: dict[str, Any]
    """`ObserverConfig`, as JSON: sensors' geometry and prediction horizon. Empty: the defaults."""
    log_std: tuple[float, float] | None
    """Natural logarithm of the standard deviations of v (m/s) and w (rad/s); none if it chooses among commands."""
    max_linear_velocity: float
    """m/s"""
    max_angular_velocity: float
    """rad/s"""
    weights_sha256: str
    """Of the tensors in the order of their names, so that both forms of one policy can be told to be the same."""
    training: dict[str, Any] = dataclasses.field(default_factory=dict)
    """Where it comes from (steps, seed, versions); free form."""
    format: int = CARD_FORMAT

    def __post_init__(self) -> None:
        require(bool(self.name), "PolicyCard.name", self.name, "not empty")
        choose("sensor configuration", self.sensors, SENSORS)
        require(self.format == CARD_FORMAT, "PolicyCard.format", self.format, str(CARD_FORMAT))

    @property
    def chooses(self) -> bool:
        """Whether it chooses among `COMMAND_GRID`."""
        return self.log_std is None

    def to_metadata(self) -> dict[str, str]:
        """For the file's table of strings."""
        return {METADATA_KEY: to_json(self)}

    @staticmethod
    def from_metadata(metadata: Mapping[str, str], source: str) -> PolicyCard:
        """The card in a file's table of strings.

        Args:
            metadata: the table.
            source: the file's name, for errors.

        Raises:
            ValueError: if the file carries no card, or a broken one.
        """
        return read_card(PolicyCard, METADATA_KEY, metadata, "policy", source)
