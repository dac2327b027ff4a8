"""Tables and plot from results made by hand."""

from __future__ import annotations

import json

import numpy as np
import pytest
from episodes import episode, straight
from PIL import Image

from densecavoid.benchmark.metrics import episode_metrics, summarise
from densecavoid.benchmark.report import report_of, tables, write_report


def cell(navigator: str, scenario: str, successes: int, privileged: bool = False) -> dict:
    """Ten episodes."""
    won, lost = episode(straight(4.75, 5.0), "success"), episode(np.zeros((200, 2)))
    figures = [episode_metrics(won if k < successes else lost) for k in range(10)]
    return {
        "navigator": navigator,
        "scenario": scenario,
        "people": "scripted",
        "pace": "brisk",
        "motion": "orca",
        "dynamics": "ideal",
        "sensors": "clean",
        "privileged": privileged,
        "policy_sha256": "c0ffee" if navigator == "densecavoid" else None,
        "seeds": [1000, 1009],
        **summarise(figures),
    }


@pytest.fixture
def results() -> dict:
    return {
        "definition": "1",
        "versions": {"numpy": "2"},
        "cells": [
            cell("densecavoid", "dense-static", 9),
            cell("go-to-goal", "dense-static", 2),
            cell("densecavoid", "robot-freezing:1.0-1.5", 10),
            cell("orca", "robot-freezing:1.0-1.5", 0, privileged=True),
        ],
    }


def section(text: str, title: str) -> str:
    return text.split(f"### {title}\n")[1].split("\n#")[0]


def test_success_has_its_interval_and_the_papers_value(results):
    table = section(tables(results), "Success")
    assert "| densecavoid | 0.90 [0.60, 0.98] (paper 0.93) | 1.00 [0.72, 1.00] |" in table
    assert "| go-to-goal | 0.20 [0.06, 0.51] |  |" in table


def test_frozen_has_the_papers_value(results):
    table = section(tables(results), "Frozen")
    assert "0.00 [0.00, 0.28] (paper 0.05)" in table
    assert "1.00 [0.72, 1.00]" in table


def test_a_table_names_its_conditions(results):
    text = tables(results)
    lines = text.splitlines()
    for promise in ("people: scripted", "pace: brisk", "motion: orca", "dynamics: ideal", "sensors: clean"):
        assert f"- {promise}" in lines
    assert "- definition 1" in lines and "- episodes: 10" in lines
    assert "1000 to 1009" in text
    assert "policy of densecavoid: sha256 c0ffee" in text
    assert "| orca (privileged) |" in text


def test_what_is_not_known_is_a_dash(results):
    row = next(
        line for line in section(tables(results), "Time to goal of successes (s)").splitlines() if "orca" in line
    )
    assert row == "| orca (privileged) |  | - |"


def test_every_table_has_every_scenario_as_a_column(results):
    headers = [line for line in tables(results).splitlines() if line.startswith("| |")]
    assert len(headers) == 13
    assert set(headers) == {"| | dense-static | robot-freezing:1.0-1.5 |"}


def test_report_can_be_made_again_from_the_results_file(results, tmp_path):
    (tmp_path / "results.json").write_text(json.dumps(results))
    report_of(tmp_path)
    again = tmp_path / "again"
    write_report(results, again)
    assert (tmp_path / "tables.md").read_text() == (again / "tables.md").read_text()
    with Image.open(again / "success.png") as picture:
        picture.load()
        assert picture.width > 600 and picture.height > 200
        assert len(set(picture.convert("RGB").resize((60, 30)).get_flattened_data())) > 10
