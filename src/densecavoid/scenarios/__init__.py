"""Families of worlds by name: one file a scenario, and the registry that finds them."""

from densecavoid.scenarios.registry import PLACES, TESTING, TRAINING, Place, TrainingScenario, make_scenario, names

__all__ = ["PLACES", "TESTING", "TRAINING", "Place", "TrainingScenario", "make_scenario", "names"]
