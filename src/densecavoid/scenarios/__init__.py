"""Families of worlds by name: one file a scenario, and the registry that finds them."""

from densecavoid.scenarios.registry import TESTING, TRAINING, TrainingScenario, make_scenario, names

__all__ = ["TESTING", "TRAINING", "TrainingScenario", "make_scenario", "names"]
