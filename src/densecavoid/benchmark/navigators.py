"""Navigators by name: what `--navigator` and `--navigators` accept. Knows their names, not how they work."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from densecavoid.baselines import Dwa, Frozone, GoToGoal, Lookahead, Orca, SocialForce
from densecavoid.benchmark.oracle import Oracle
from densecavoid.frames import Navigator, RobotConfig, choose
from densecavoid.perception.config import PeopleFrom


def _policy(name: str | Path, people_from: PeopleFrom = "detector") -> Navigator:
    # Imported here so that classical navigators work where there is no ONNX Runtime.
    from densecavoid.policy.navigator import load_policy

    return load_policy(name, people_from=people_from)


_SOURCES: dict[str, PeopleFrom] = {":truth": "truth", ":boxes": "boxes", ":nothing": "nothing"}
"""What may follow a policy's name, to compare with: people's places from elsewhere than its own detector."""


_LEARNED = ("densecavoid", "depth-lidar", "depth")
"""Policies that come with the package."""

_NAVIGATORS: dict[str, Callable[[RobotConfig], Navigator]] = {
    **{name: lambda robot, name=name: _policy(name) for name in _LEARNED},
    "frozone": lambda robot: Frozone(_policy("densecavoid"), robot),
    "dwa": Dwa,
    "social-force": SocialForce,
    "orca": Orca,
    "orca-privileged": lambda robot: Orca(robot, source="truth"),
    "lookahead": Lookahead,
    "lookahead-privileged": lambda robot: Lookahead(robot, source="truth"),
    "go-to-goal": GoToGoal,
    "oracle": lambda robot: Oracle(),
}


def navigator_names() -> tuple[str, ...]:
    """The registered names; a path to an .onnx policy is accepted beside them."""
    return tuple(_NAVIGATORS)


def make_navigator(name: str, robot: RobotConfig = RobotConfig()) -> Navigator:
    """A new navigator.

    Args:
        name: One of `navigator_names()`, or the path of an exported policy (.onnx). A policy finds people by itself;
            `:truth` behind its name gives it their true places, `:boxes` those with the detector's errors (both are
            privileged), `:nothing` an empty prediction frame.
        robot: Whose limits it keeps.

    Raises:
        ValueError: naming what was asked for and what there is.
        FileNotFoundError: for a path where no policy is.
    """
    for suffix, people_from in _SOURCES.items():
        policy = name.removesuffix(suffix)
        if policy != name and (policy.endswith(".onnx") or policy == "densecavoid"):
            return _policy(policy, people_from)
    if name.endswith(".onnx"):
        return _policy(Path(name))
    choose("navigator", name, (*navigator_names(), "PATH.onnx"))
    return _NAVIGATORS[name](robot)


def policy_sha256(navigator: Navigator) -> str | None:
    """Hash of the policy's file, for the tables; None for a navigator that has no policy."""
    policy = getattr(navigator, "policy", None)
    return getattr(policy, "sha256", None)
