"""Navigators that are not DenseCAvoid, one a file; what a result is worth is seen beside them."""

from densecavoid.baselines.dwa import Dwa
from densecavoid.baselines.frozone import Frozone
from densecavoid.baselines.go_to_goal import GoToGoal
from densecavoid.baselines.lookahead import Lookahead
from densecavoid.baselines.orca import Orca
from densecavoid.baselines.social_force import SocialForce

__all__ = ["Dwa", "Frozone", "GoToGoal", "Lookahead", "Orca", "SocialForce"]
