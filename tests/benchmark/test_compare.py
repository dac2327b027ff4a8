"""What changed between two benchmarks, on episodes made by hand."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from densecavoid.benchmark.compare import compare, comparison, other_conditions
from densecavoid.benchmark.statistics import unpaired_bootstrap, wilson_interval
from densecavoid.cli import main


def benchmark(folder: Path, successes: dict[str, list[bool]], first_seed: int = 0, **changes) -> Path:
    """A results.json with one scenario: which of the worlds each navigator solved."""
    folder.mkdir()
    base = {"people": "scripted", "pace": "scenario", "motion": "anticipation", "dynamics": "ideal", "sensors": "clean"}
    cells = [{**base, "navigator": n, "scenario": "hall", "policy_sha256": None, **changes} for n in successes]
    lines = [
        {
            "navigator": navigator,
            "scenario": "hall",
            "seed": first_seed + seed,
            "outcome": "success" if won else "collision",
            "frozen": False,
            "at_fault": not won,
        }
        for navigator, wins in successes.items()
        for seed, won in enumerate(wins)
    ]
    (folder / "episodes.jsonl").write_text("\n".join(map(json.dumps, lines)))
    (folder / "results.json").write_text(json.dumps({"definition": "1", "cells": cells}))
    return folder / "results.json"


def half(count: int = 200) -> list[bool]:
    return [seed % 2 == 0 for seed in range(count)]


def test_a_real_change_is_told_from_noise(tmp_path):
    """`better` solves 20 worlds more and none less; `same` solves three others instead of three."""
    better = half()
    better[1:41:2] = [True] * 20
    same = half()
    same[0:6] = [False, True] * 3
    before = benchmark(tmp_path / "a", {"better": half(), "same": half()})
    after = benchmark(tmp_path / "b", {"better": better, "same": same})
    changes = {(change.navigator, change.figure): change for change in compare(before, after)}
    improved = changes["better", "success"]
    assert (improved.before, improved.after, improved.pairs) == (0.5, 0.6, 200)
    assert improved.difference.mean == pytest.approx(0.1) and not improved.is_noise
    assert changes["better", "collision at fault"].difference.mean == pytest.approx(-0.1)
    assert changes["same", "success"].is_noise and changes["better", "frozen"].is_noise
    text = comparison(list(changes.values()))
    assert "2 of 6 differences are more than noise" in text
    assert "- better in hall: success rose from 0.50 to 0.60" in text
    assert "same in hall" not in text.split("|")[0]


def test_other_worlds_are_two_samples_and_less_sure(tmp_path):
    better = half()
    better[1:31:2] = [True] * 15
    before = benchmark(tmp_path / "a", {"better": half()})
    after = benchmark(tmp_path / "b", {"better": better}, first_seed=5000)
    change = compare(before, after)[0]
    assert change.pairs == 0 and change.is_noise


def test_unpaired_interval_is_about_that_of_two_rates():
    """Against Newcombe's interval for a difference (method 10), which is made of Wilson's."""
    a, b = np.array(half()) | (np.arange(200) < 60), np.array(half())
    difference = unpaired_bootstrap(a.astype(float), b.astype(float))
    (low_a, high_a), (low_b, high_b) = wilson_interval(int(a.sum()), 200), wilson_interval(int(b.sum()), 200)
    d = a.mean() - b.mean()
    low = d - np.hypot(a.mean() - low_a, high_b - b.mean())
    high = d + np.hypot(high_a - a.mean(), b.mean() - low_b)
    assert (difference.low, difference.high) == pytest.approx((low, high), abs=0.015)


def test_what_else_was_different_is_said(tmp_path):
    before = benchmark(tmp_path / "a", {"orca": half()})
    after = benchmark(tmp_path / "b", {"orca": half()}, dynamics="dynamic", policy_sha256="abc")
    assert other_conditions(before, after) == ["dynamics: ideal before, dynamic after", "another policy of orca"]


def test_from_the_command_line(tmp_path, capsys):
    before = benchmark(tmp_path / "a", {"orca": half()})
    assert main(["benchmark", "--compare", str(before), str(before)]) == 0
    assert "0 of 3 differences are more than noise" in capsys.readouterr().out
    assert main(["benchmark", "--compare", str(before), str(tmp_path / "none.json")]) == 2
