"""The paper's four stages (Section IV-C) as a small state machine: which training scenarios run, how hard, in what
shares. It owns no worlds and draws nothing at random.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from densecavoid.frames import choose, require
from densecavoid.scenarios import TRAINING
from densecavoid.scenarios.mixture import Mixture

STAGES = tuple(TRAINING)
"""From the simplest; each starts from the policy of the stage before (paper, Section IV-C)."""


@dataclass(frozen=True)
class CurriculumConfig:
    """When training moves on. Difficulty is a level in [0, 1] within each stage."""

    initial_level: float = 0.0
    """Difficulty at which each stage begins."""
    level_step: float = 0.1
    """Raise of the difficulty at each promotion."""
    threshold: float = 0.75
    """Success rate that promotes."""
    window: int = 200
    """Episodes of the stage over which success is taken; emptied by a promotion."""
    simpler_share: float = 0.3
    """Share of the worlds that keep running the stages already passed, each at the level it has come to."""
    patience: int = 5_000
    """Episodes after which a stage is passed all the same; its level goes on rising beside the next one's."""

    def __post_init__(self) -> None:
        require(0 <= self.initial_level <= 1, "CurriculumConfig.initial_level", self.initial_level, "in [0, 1]")
        require(0 < self.level_step <= 1, "CurriculumConfig.level_step", self.level_step, "in (0, 1]")
        require(0 < self.threshold <= 1, "CurriculumConfig.threshold", self.threshold, "in (0, 1]")
        require(self.window > 0, "CurriculumConfig.window", self.window, "positive")
        require(self.patience > 0, "CurriculumConfig.patience", self.patience, "positive")
        require(0 <= self.simpler_share < 1, "CurriculumConfig.simpler_share", self.simpler_share, "in [0, 1)")


class MixturePart(NamedTuple):
    """One scenario of the running mixture."""

    scenario: str
    level: float
    weight: float


class Curriculum:
    """Owns the stage being learned, the level of every stage, and the latest outcomes."""

    def __init__(self, config: CurriculumConfig, stages: Sequence[str] = STAGES) -> None:
        """
        Args:
            config: when to move on.
            stages: names of training scenarios, simplest first; one name trains it alone.

        Raises:
            ValueError: if a stage is not a training scenario.
        """
        require(len(stages) > 0, "Curriculum stages", stages, "at least one")
        self.stages = tuple(choose("stage", stage, STAGES) for stage in stages)
        self.config = config
        self.stage_index = 0
        self.levels = [config.initial_level] * len(self.stages)
        self._outcomes: list[deque[bool]] = [deque(maxlen=config.window) for _ in self.stages]
        self._episodes = 0

    @property
    def stage(self) -> str:
        """The stage being learned."""
        return self.stages[self.stage_index]

    @property
    def level(self) -> float:
        """Its difficulty."""
        return self.levels[self.stage_index]

    @property
    def success_rate(self) -> float:
        """Over the latest episodes of the stage; NaN before the first."""
        outcomes = self._outcomes[self.stage_index]
        return sum(outcomes) / len(outcomes) if outcomes else float("nan")

    @property
    def window_full(self) -> bool:
        """Whether the success rate rests on as many episodes as a promotion asks for."""
        return len(self._outcomes[self.stage_index]) == self.config.window

    def mixture(self) -> tuple[MixturePart, ...]:
        """The scenarios to run now; their weights sum to 1."""
        passed = self.stages[: self.stage_index]
        simpler = self.config.simpler_share if passed else 0.0
        current = MixturePart(self.stage, self.level, 1.0 - simpler)
        parts = zip(passed, self.levels, strict=False)
        return (*(MixturePart(name, level, simpler / len(passed)) for name, level in parts), current)

    def scenario(self) -> Mixture:
        """The mixture as a scenario that worlds can be drawn from."""
        parts = self.mixture()
        return Mixture(
            tuple(TRAINING[part.scenario].at_level(part.level) for part in parts), tuple(part.weight for part in parts)
        )

    def update(self, scenarios: Sequence[str], successes: Sequence[bool]) -> bool:
        """Takes note of episodes that ended.

        Args:
            scenarios: name of the scenario of each; those of stages to come do not count.
            successes: whether each succeeded.

        Returns:
            Whether the mixture changed.
        """
        for name, success in zip(scenarios, successes, strict=True):
            if name in self.stages[: self.stage_index + 1]:
                self._outcomes[self.stages.index(name)].append(success)
            self._episodes += name == self.stage
        mastered = self._mastered(self.stage_index) and self.level == 1.0
        changed = False
        for index in range(self.stage_index + 1):
            if self._mastered(index) and self.levels[index] < 1.0:
                # Rounding keeps ten steps of .1 from ending at .9999999999999999.
                self.levels[index] = min(1.0, round(self.levels[index] + self.config.level_step, 9))
                self._outcomes[index].clear()
                changed = True
        if (mastered or self._episodes >= self.config.patience) and self.stage_index + 1 < len(self.stages):
            self.stage_index += 1
            self._episodes = 0
            changed = True
        return changed

    def _mastered(self, index: int) -> bool:
        outcomes = self._outcomes[index]
        return len(outcomes) == self.config.window and sum(outcomes) >= self.config.threshold * len(outcomes)

    def state_dict(self) -> dict[str, Any]:
        """JSON-able state."""
        return {
            "stage": self.stage,
            "episodes": self._episodes,
            "levels": list(self.levels),
            "outcomes": [[int(outcome) for outcome in outcomes] for outcomes in self._outcomes],
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`.

        Raises:
            ValueError: if the stage is not among those of this configuration.
        """
        self.stage_index = self.stages.index(choose("stage", state["stage"], self.stages))
        self._episodes = int(state["episodes"])
        self.levels = [float(level) for level in state["levels"]]
        for outcomes, saved in zip(self._outcomes, state["outcomes"], strict=True):
            outcomes.clear()
            outcomes.extend(bool(outcome) for outcome in saved)
