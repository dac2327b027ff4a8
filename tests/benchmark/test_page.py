"""The page of results: whole, self-contained, and with every number that it promises."""

from __future__ import annotations

import json
import re
from dataclasses import asdict
from html.parser import HTMLParser

import numpy as np
import pytest
from episodes import episode, straight
from test_report import cell

from densecavoid.benchmark.charts import path_overlay, success_against_density
from densecavoid.benchmark.episode import PeopleTracks
from densecavoid.benchmark.metrics import episode_metrics
from densecavoid.benchmark.page import write_page
from densecavoid.benchmark.scenes import scene_of
from densecavoid.sim.floorplan import FloorPlan


class Reader(HTMLParser):
    """Collects text, and checks that tags are closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text: list[str] = []
        self.links: list[str | None] = []

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "br", "input", "line", "circle", "polyline"):
            self.open.append(tag)
        self.links += [value for name, value in attrs if name in ("src", "href")]

    def handle_endtag(self, tag):
        if tag not in ("line", "circle", "polyline"):
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def walk(outcome: str = "success"):
    """An episode with a person who comes along and a box."""
    way = straight(4.75, 5.0)
    instants = np.arange(len(way), dtype=np.int32)
    pos = np.column_stack([6.0 - 0.05 * instants, np.ones(len(way))]).astype(np.float32)
    people = PeopleTracks(instants, np.zeros(len(way), np.int32), pos, np.full(len(way), 0.25, np.float32))
    plan = FloorPlan()
    plan.box(2.0, 3.0, 1.0, 0.5, 0.3)
    return episode(way, outcome, people=people, floor_plan=plan)


@pytest.fixture
def page(tmp_path) -> str:
    won, lost = episode_metrics(walk()), episode_metrics(episode(np.zeros((200, 2)), "timeout"))
    rows, paths = [], []
    for name, wins in (("densecavoid", 9), ("dwa", 4), ("oracle", 10)):
        for k in range(10):
            figures = asdict(won if k < wins else lost) | {"seed": k, "density_per_m2": 0.05 + 0.03 * k}
            rows.append({"navigator": name, **figures, "scenario": "dense-ped"})
        way = [[0.0, 0.0], [2.0, 0.3], [4.75, 0.0], [5.0, 0.0]]
        paths.append({"navigator": name, "scenario": "dense-ped", "paths": [way] * 10})
    (tmp_path / "episodes.jsonl").write_text("\n".join(json.dumps(row) for row in rows))
    (tmp_path / "paths.json").write_text(json.dumps(paths))
    scene = {"scenario": "dense-ped", "why": "worst: froze </script>", **scene_of(walk("timeout"))}
    (tmp_path / "scenes.json").write_text(json.dumps([scene]))
    world = {"scenario": "dense-ped", "tried": 12, "solvable": 10, "share": 10 / 12, "share_ci95": [0.55, 0.95]}
    world |= {"filtered": True, "admitted": 10, "reference_time_s": 16.2}
    cells = [
        cell("densecavoid", "dense-ped", 9, True),
        cell("dwa", "dense-ped", 4),
        cell("oracle", "dense-ped", 10, True),
    ]
    cells = [one | {"pace": "scenario", "motion": "anticipation"} for one in cells]
    write_page({"definition": "1", "versions": {"numpy": "2"}, "worlds": [world], "cells": cells}, tmp_path)
    return (tmp_path / "index.html").read_text()


def test_page_is_well_formed_and_needs_nothing_else(page):
    reader = Reader()
    reader.feed(page)
    assert reader.open == []
    assert reader.links == [] and "http" not in page and "@import" not in page


def test_page_says_what_was_measured(page):
    reader = Reader()
    reader.feed(page)
    text = " ".join(reader.text)
    for promise in ("paper 1.00", "10 of 12 (83 %)", "16.2 s", "sees the truth", "a robot that freezes"):
        assert promise in text
    for title in (
        "Who arrives?",
        "Who freezes?",
        "Success against density",
        "The ways they take",
        "Is it really better?",
    ):
        assert title in text
    assert text.count("+0.50") == 1  # densecavoid solves five of ten worlds more than dwa
    assert len(re.findall("<polyline", page)) >= 3 * 10 + 3


def test_scenes_are_read_back_whole(page):
    data = re.search(r'<script type="application/json" id="scenes">(.*?)</script>', page, re.DOTALL)
    assert data is not None
    (scene,) = json.loads(data[1])
    assert scene["why"].endswith("</script>")
    assert len(scene["robot"]) == len(scene["people"]) == 26  # 5 s, a frame each .2 s and the first
    assert scene["people"][10] == [[5.0, 1.0, 0.25]]
    assert len(scene["boxes"]) == 1 and not scene["boxes"][0][1]


def test_success_rises_where_it_should():
    """Two bins of density: nobody arrives in the crowded one."""
    rows = [{"density_per_m2": 0.1 + 0.01 * k, "success": k < 20} for k in range(40)]
    drawing = success_against_density({"orca": rows})
    assert drawing is not None
    heights = [float(match) for match in re.findall(r'cy="([\d.]+)"', drawing)]
    assert heights[0] == pytest.approx(12.0) and heights[-1] == pytest.approx(260.0)
    assert success_against_density({"orca": [{"density_per_m2": 0.0, "success": True}] * 9}) is None


def test_paths_begin_left_and_lead_right():
    """A way along -y is turned to lie along +x."""
    drawing = path_overlay([[[1.0, 5.0], [1.0, 3.0], [1.0, 1.0], [1.0, 0.0]]], ["success"])
    (points,) = re.findall(r'points="([^"]+)"', drawing)
    xs, ys = zip(*[map(float, point.split(",")) for point in points.split()], strict=True)
    assert list(xs) == sorted(xs) and max(ys) - min(ys) < 1e-6
