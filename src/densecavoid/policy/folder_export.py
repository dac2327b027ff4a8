"""Writes the folder that robots run (`folder`): the policy, and whatever finds and foresees people for it."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
from pathlib import Path

from densecavoid.env.observation import ObserverConfig
from densecavoid.perception.detector.detector import DETECTORS
from densecavoid.perception.legs import WEIGHTS
from densecavoid.perception.networks import SHIPPED_DETECTOR
from densecavoid.perception.predictor.learned import LEARNED
from densecavoid.perception.predictor.registry import SHIPPED_WEIGHTS
from densecavoid.policy.card import PolicyCard
from densecavoid.policy.folder import FILE_NAMES, FolderFile, Manifest, roles_needed, write_manifest
from densecavoid.policy.navigator import load_policy, read_observer_config
from densecavoid.policy.runtime import POLICIES, OnnxPolicy


def export_folder(
    policy: str | Path,
    out: Path,
    detector: str | Path = SHIPPED_DETECTOR,
    predictor: str | Path | None = None,
) -> tuple[Path, list[str]]:
    """Writes the folder of a policy, and loads it to see that everything fits.

    Args:
        policy: who decides: a shipped one's name, or an ONNX file.
        out: the folder; made, or its files written again.
        detector: who finds people in depth images, the same way.
        predictor: who foresees them, the same way, for a policy that was trained with a predictor that has weights;
            None: the one that ships for it.

    Returns:
        the folder, and what a robot should know (lines of text; they are in the manifest too).

    Raises:
        FileNotFoundError: for a network that is not there.
        ValueError: for one that does not fit the policy, or a predictor that it has no use for.
    """
    card = OnnxPolicy(policy).card
    # On a robot nobody knows people's true places, whatever the training had.
    observation = read_observer_config(card.observation, "detector")
    needed = roles_needed(card, observation)
    if predictor is not None and "predictor" not in needed:
        raise ValueError(
            f"predictor is {str(predictor)!r}, expected none: {card.name!r} uses {observation.predictor!r}"
        )
    content = {"policy": POLICIES.read(policy), "legs": WEIGHTS.read_bytes()}
    if "detector" in needed:
        content["detector"] = DETECTORS.read(detector)
    if "predictor" in needed:
        content["predictor"] = LEARNED.read(predictor or SHIPPED_WEIGHTS[observation.predictor])
    out.mkdir(parents=True, exist_ok=True)
    files = {}
    for role, name in FILE_NAMES.items():
        if role not in content:
            (out / name).unlink(missing_ok=True)  # of another policy, exported here before
            continue
        data = content[role]
        (out / name).write_bytes(data)
        files[role] = dataclasses.asdict(FolderFile(name, hashlib.sha256(data).hexdigest(), len(data)))
    notes = _notes(card, observation, needed)
    versions = {name: importlib.metadata.version(name) for name in ("densecavoid", "numpy", "numba", "onnxruntime")}
    write_manifest(out, Manifest(card.name, files, dataclasses.asdict(observation), notes, versions))
    load_policy(out)
    return out, notes


def _notes(card: PolicyCard, observation: ObserverConfig, needed: tuple[str, ...]) -> list[str]:
    """Who finds people and who foresees them."""
    by_legs = f"by their legs in scans ({FILE_NAMES['legs']})"
    if "detector" in needed:
        found = f"people are found in depth images ({FILE_NAMES['detector']}) and {by_legs}"
    else:
        found = f"{card.name} does not look at people; the safety filter finds them {by_legs}"
    foreseen = f"people are foreseen by {observation.predictor}"
    return [found, foreseen + (f" ({FILE_NAMES['predictor']})" if "predictor" in needed else ": no network for that")]
