"""Navigators that are not DenseCAvoid, one a file; what a result is worth is seen beside them."""

from densecavoid.baselines.go_to_goal import GoToGoal

__all__ = ["GoToGoal"]
