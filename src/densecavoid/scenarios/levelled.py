"""What the training scenarios share: a level from 0 (easy) to 1, the curriculum's dial."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

from densecavoid.frames import require

# Not typing.Self, which beartype cannot check in a method decorated by itself.
LevelledT = TypeVar("LevelledT", bound="Levelled")


@dataclass(frozen=True)
class Levelled:
    """A scenario with a level; each says what its levels mean."""

    level: float = 1.0

    def __post_init__(self) -> None:
        require(0.0 <= self.level <= 1.0, f"{type(self).__name__}.level", self.level, "in [0, 1]")

    def at_level(self: LevelledT, level: float) -> LevelledT:
        """The same scenario at another level."""
        return replace(self, level=level)
