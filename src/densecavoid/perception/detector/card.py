"""What a detector's file says about itself, in safetensors as in ONNX. No torch: the runtime reads it."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from densecavoid.frames import CameraConfig, choose, require
from densecavoid.networks.config_json import read_card

METADATA_KEY = "densecavoid.detector"
CARD_FORMAT = 1


@dataclass(frozen=True)
class PlaceError:
    """How far to trust a place; fitted to images that the network was not trained on. The standard deviation of x and
    of y is the root of the sum of squares of these terms."""

    floor_m: float = 0.02
    """Of everybody."""
    per_m2: float = 0.001
    """Times the distance squared."""
    unsure_m: float = 0.1
    """Times 1 - confidence."""
    hidden_m: float = 0.1
    """Times the third power of the share of the box that shows something else than the person: the gaps beside arms and
    legs do no harm."""
    cut_m: float = 0.05
    """Where a side of the image cuts the box."""

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            require(value >= 0 and math.isfinite(value), f"PlaceError.{name}", value, "0 or more, and finite")


@dataclass(frozen=True)
class DetectorCard:
    """Everything that must agree between training and use."""

    name: str
    kind: Literal["depth", "rgb"]
    network: str
    """The Darknet configuration's text."""
    threshold: float
    """Least confidence of what is found."""
    max_overlap: float
    """What boxes of one class may overlap (IoU) without being one thing."""
    camera: CameraConfig | None = None
    """A depth camera of the view and the ranges that the network was trained with; its mount is free."""
    place_error: PlaceError = field(default_factory=PlaceError)
    training: dict[str, Any] = field(default_factory=dict)
    """Where it comes from (command, settings, images, results); free form."""
    format: int = CARD_FORMAT

    def __post_init__(self) -> None:
        choose("detector's kind", self.kind, ("depth", "rgb"))
        require(0 < self.threshold < 1, "DetectorCard.threshold", self.threshold, "in (0, 1)")
        require(0 <= self.max_overlap <= 1, "DetectorCard.max_overlap", self.max_overlap, "in [0, 1]")
        require(self.kind == "rgb" or self.camera is not None, "DetectorCard.camera", self.camera, "a depth camera")
        require(self.format == CARD_FORMAT, "DetectorCard.format", self.format, str(CARD_FORMAT))

    def to_json(self) -> str:
        """For people, and for the file's table of strings."""
        return json.dumps(dataclasses.asdict(self), indent=1, sort_keys=True)

    def to_metadata(self) -> dict[str, str]:
        """The file's table of strings."""
        return {METADATA_KEY: self.to_json()}

    @staticmethod
    def from_metadata(metadata: Mapping[str, str], source: str) -> DetectorCard:
        """The card in a file's table of strings.

        Raises:
            ValueError: naming `source`, if the file carries no card, or a broken one.
        """
        return read_card(DetectorCard, METADATA_KEY, metadata, "detector", source)
