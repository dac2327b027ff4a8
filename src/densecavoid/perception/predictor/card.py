"""What the file of a learned predictor says about itself, in safetensors, ONNX and JSON alike. No torch."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from densecavoid.frames import choose, require
from densecavoid.networks.config_json import read_card, to_json

METADATA_KEY = "densecavoid.predictor"
CARD_FORMAT = 1
INPUTS = {"compact": ("own", "neighbours"), "robust-tp": ("own", "neighbour", "pair", "cells")}
"""Of the networks, by kind."""
KINDS = tuple(INPUTS)


@dataclass(frozen=True)
class PredictorCard:
    """Everything that must agree between training and use."""

    name: str
    kind: str
    """One of `KINDS`: which features the network takes."""
    period_s: float
    """Time between two places of a history."""
    samples: int
    """Places of a history; shorter ones are padded as not valid."""
    horizons_s: tuple[float, ...]
    """Of the network's outputs, ascending; what lies between is interpolated."""
    base_acceleration_std: float
    """Of the Kalman filter whose velocity the outputs relate to where the tracker gives none, m/s2."""
    base_measurement_std: float
    """m"""
    network: dict[str, Any]
    """The network's configuration, as JSON."""
    temperature: tuple[float, ...]
    """By which each horizon's standard deviations are multiplied, fitted on validation runs."""
    training: dict[str, Any] = dataclasses.field(default_factory=dict)
    """Where it comes from: data, what was left out, seeds, minutes; free form."""
    format: int = CARD_FORMAT

    def __post_init__(self) -> None:
        require(bool(self.name), "PredictorCard.name", self.name, "not empty")
        choose("kind of predictor", self.kind, KINDS)
        require(self.period_s > 0, "PredictorCard.period_s", self.period_s, "above 0 s")
        require(self.samples >= 2, "PredictorCard.samples", self.samples, "2 or more")
        ascending = all(a < b for a, b in zip((0.0, *self.horizons_s), self.horizons_s, strict=False))
        require(
            len(self.horizons_s) > 0 and ascending, "PredictorCard.horizons_s", self.horizons_s, "ascending, above 0"
        )
        require(
            len(self.temperature) == len(self.horizons_s) and min(self.temperature) > 0,
            "PredictorCard.temperature",
            self.temperature,
            "one above 0 for each horizon",
        )
        require(self.format == CARD_FORMAT, "PredictorCard.format", self.format, str(CARD_FORMAT))

    def to_metadata(self) -> dict[str, str]:
        """For the file's table of strings."""
        return {METADATA_KEY: to_json(self)}

    @staticmethod
    def from_metadata(metadata: Mapping[str, str], source: str) -> PredictorCard:
        """The card in a file's table of strings.

        Raises:
            ValueError: if the file `source` carries no card, or a broken one.
        """
        return read_card(PredictorCard, METADATA_KEY, metadata, "predictor", source)
