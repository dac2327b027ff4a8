"""Which files find and foresee people. What ships is used unless others are named, as an exported folder does."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

SHIPPED_DETECTOR = "depth-yolo"
"""What a robot finds people with in depth images."""


@dataclass(frozen=True)
class PeopleNetworks:
    """Of perception."""

    detector: str | Path = SHIPPED_DETECTOR
    """People in depth images: a shipped network's name, or an ONNX file."""
    legs: Path | None = None
    """Legs in scans: an .npz file; None: the one that ships."""
    predictor: str | Path | None = None
    """A shipped learned predictor's name, or an ONNX file; None: the one that ships for the predictor configured."""
