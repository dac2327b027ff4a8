"""Two benchmarks compared: what changed between two `results.json`, and whether it is more than noise."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from densecavoid.benchmark.statistics import Difference, paired_bootstrap, unpaired_bootstrap
from densecavoid.frames import require

FIGURES = {"success": "success", "frozen": "frozen", "collision at fault": "at_fault"}
"""What is compared: its name, and the field of an episode that says so."""
CONDITIONS = ("people", "pace", "motion", "dynamics", "sensors")


@dataclass(frozen=True)
class Change:
    """One figure of one cell, before and after."""

    navigator: str
    scenario: str
    figure: str
    before: float
    after: float
    difference: Difference
    """After less before."""
    pairs: int
    """Worlds that both have driven in; 0: none, so that the interval is that of two separate samples."""

    @property
    def is_noise(self) -> bool:
        """Whether chance alone may have made the difference (95 %)."""
        return not self.difference.excludes_zero


def load_episodes(results_path: Path) -> dict[tuple[str, str], dict[int, dict]]:
    """Figures of each episode by (navigator, scenario) and seed, from the `episodes.jsonl` beside a `results.json`."""
    cells: dict[tuple[str, str], dict[int, dict]] = {}
    for line in (Path(results_path).parent / "episodes.jsonl").read_text(encoding="utf-8").splitlines():
        row = json.loads(line)
        row["success"] = row["outcome"] == "success"
        cells.setdefault((row["navigator"], row["scenario"]), {})[row["seed"]] = row
    return cells


def difference_of(after: dict[int, dict], before: dict[int, dict], figure: str) -> tuple[float, float, Difference, int]:
    """Of one yes-or-no figure: means (after, before), their difference with its interval, and the number of pairs.

    Worlds that both have are compared in pairs; where there are hardly any, the two are separate samples.
    """
    common = sorted(after.keys() & before.keys())
    if 2 * len(common) > min(len(after), len(before)):
        a, b = (np.array([float(rows[seed][figure]) for seed in common]) for rows in (after, before))
        return float(a.mean()), float(b.mean()), paired_bootstrap(a, b), len(common)
    a, b = (np.array([float(row[figure]) for row in rows.values()]) for rows in (after, before))
    return float(a.mean()), float(b.mean()), unpaired_bootstrap(a, b), 0


def compare(before: Path, after: Path) -> list[Change]:
    """Every cell that two results share.

    Args:
        before, after: `results.json` files, with `episodes.jsonl` beside them.

    Raises:
        ValueError: when they were measured by different definitions, or share no cell.
        OSError: if a file is not there.
    """
    old, new = (json.loads(Path(path).read_text(encoding="utf-8")) for path in (before, after))
    same = old["definition"] == new["definition"]
    require(same, "definitions", (old["definition"], new["definition"]), "the same: other figures mean other things")
    old_episodes, new_episodes = load_episodes(before), load_episodes(after)
    keys = [
        key
        for cell in new["cells"]
        if (key := (cell["navigator"], cell["scenario"])) in old_episodes and key in new_episodes
    ]
    require(len(keys) > 0, "cells that both results have", 0, "at least one")
    changes = []
    for key in keys:
        for name, figure in FIGURES.items():
            a, b, difference, pairs = difference_of(new_episodes[key], old_episodes[key], figure)
            changes.append(Change(*key, name, b, a, difference, pairs))
    return changes


def other_conditions(before: Path, after: Path) -> list[str]:
    """What the two results were measured under that is not the same, a line each."""
    old, new = (json.loads(Path(path).read_text(encoding="utf-8")) for path in (before, after))
    lines = []
    for name in CONDITIONS:
        values = [sorted({str(cell[name]) for cell in results["cells"]}) for results in (old, new)]
        if values[0] != values[1]:
            lines.append(f"{name}: {', '.join(values[0])} before, {', '.join(values[1])} after")
    hashes = [{cell["navigator"]: cell["policy_sha256"] for cell in results["cells"]} for results in (old, new)]
    for navigator in sorted(hashes[0].keys() & hashes[1].keys()):
        if hashes[0][navigator] != hashes[1][navigator]:
            lines.append(f"another policy of {navigator}")
    return lines


def comparison(changes: Sequence[Change], conditions: Sequence[str] = ()) -> str:
    """The changes in words: first what is more than noise, then all of them as a table."""
    real = [change for change in changes if not change.is_noise]
    lines = [f"not the same: {line}" for line in conditions]
    by_chance = 0.05 * len(changes)
    lines.append(
        f"{len(real)} of {len(changes)} differences are more than noise (95 % intervals without zero; "
        f"about {by_chance:.0f} would be by chance alone if nothing had changed)."
    )
    for change in real:
        way = "rose" if change.difference.mean > 0 else "fell"
        lines.append(
            f"- {change.navigator} in {change.scenario}: {change.figure} {way} from {change.before:.2f} to "
            f"{change.after:.2f}"
        )
    lines += [
        "",
        "| navigator | scenario | figure | before | after | difference [95 %] | worlds in common | |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for change in changes:
        d = change.difference
        verdict = "noise" if change.is_noise else "changed"
        lines.append(
            f"| {change.navigator} | {change.scenario} | {change.figure} | {change.before:.3f} | {change.after:.3f} | "
            f"{d.mean:+.3f} [{d.low:+.3f}, {d.high:+.3f}] | {change.pairs or 'none'} | {verdict} |"
        )
    return "\n".join(lines) + "\n"
