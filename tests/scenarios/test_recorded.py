"""Recorded people in the simulator: where they were recorded, or making way and coming back."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from densecavoid.frames import Command
from densecavoid.scenarios import make_scenario
from densecavoid.scenarios.recorded import TrackFile, read_walls
from densecavoid.scenarios.recordings import load_recording
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.spec import Replay, WorldSpec
from densecavoid.sim.world import Simulator


def write_tracks(path: Path, people: int = 5, steps: int = 80) -> Path:
    """People side by side, 1.2 m apart, walking along x at 1 m/s; each comes 2 s after the one before."""
    rows = [
        f"{10 * (k + 5 * p)} {p} {0.4 * k - 8:.4f} {1.2 * (p - people // 2):.4f}"
        for p in range(people)
        for k in range(steps)
    ]
    path.write_text("\n".join(rows))
    return path


class Standing:
    """A robot that stands in the way of recorded people."""

    name = "standing"

    def __init__(self, path: Path, place: tuple[float, float], reactive: bool, start_s: float = 0.0) -> None:
        replay = Replay(load_recording(path, "tracks"), start_s, reactive)
        self.spec = WorldSpec("standing", FloorPlan(), (*place, math.pi), (50.0, 0.0), replay=replay)

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return self.spec


def stand(sim: Simulator) -> None:
    sim.step(Command(np.zeros(sim.num_worlds), np.zeros(sim.num_worlds)))


def test_plain_replay_is_to_the_letter(tmp_path):
    path = write_tracks(tmp_path / "a.txt")
    recording = load_recording(path, "tracks")
    sim = Simulator(Standing(path, (100.0, 100.0), reactive=False, start_s=3.0), 1)
    sim.reset(np.zeros(1, np.int64))
    for step in range(120):
        people, (person, state) = sim.people(), recording.at(60 + 2 * step)
        there = people.active[0]
        assert sorted(people.id[0][there]) == sorted(person)
        order = np.argsort(people.id[0][there])
        np.testing.assert_allclose(people.pos_w[0][there][order], state[:, :2], atol=1e-5)
        np.testing.assert_allclose(people.vel_w[0][there][order], state[:, 2:], atol=1e-4)
        stand(sim)


def test_a_person_keeps_one_slot_while_others_come_and_go(tmp_path):
    sim = Simulator(Standing(write_tracks(tmp_path / "a.txt"), (100.0, 100.0), reactive=False), 1)
    sim.reset(np.zeros(1, np.int64))
    slots: dict[int, set[int]] = {}
    for _ in range(300):
        people = sim.people()
        for slot in np.flatnonzero(people.active[0]):
            slots.setdefault(int(people.id[0, slot]), set()).add(int(slot))
        stand(sim)
    assert len(slots) == 5 and all(len(used) == 1 for used in slots.values())


def test_people_are_gone_when_the_recording_ends(tmp_path):
    path = write_tracks(tmp_path / "a.txt")
    end = load_recording(path, "tracks").duration_s
    sim = Simulator(Standing(path, (100.0, 100.0), reactive=False, start_s=end - 0.5), 1)
    sim.reset(np.zeros(1, np.int64))
    assert sim.people().active.any()
    for _ in range(8):
        stand(sim)
    assert not sim.people().active.any()


def test_people_who_react_make_way_and_come_back_where_plain_ones_collide(tmp_path):
    path = write_tracks(tmp_path / "a.txt", people=1)
    outcome = {}
    for reactive in (False, True):
        sim = Simulator(Standing(path, (0.0, 0.05), reactive), 1)
        sim.reset(np.zeros(1, np.int64))
        aside, nearest, pos = 0.0, math.inf, np.zeros(2)
        for _ in range(140):
            stand(sim)
            pos = sim.people().pos_w[0, 0]
            aside, nearest = max(aside, abs(float(pos[1]))), min(nearest, float(sim.clearance_people_m[0]))
        outcome[reactive] = nearest
        if reactive:
            assert 0.3 < aside < 1.5
            recorded = load_recording(path, "tracks").at(280)[1][0]
            assert math.dist(pos, recorded[:2]) < 0.3
    assert outcome[False] < 0.0  # walked straight through the place of the robot
    assert outcome[True] >= 0.18  # the robot's radius


def test_walls_are_read_or_refused_by_line(tmp_path):
    path = tmp_path / "a.walls"
    path.write_text("# a hall\n0 0 4 0\n\n0 3 4 3\n")
    np.testing.assert_array_equal(read_walls(path), [[0, 0, 4, 0], [0, 3, 4, 3]])
    path.write_text("0 0 4 0\n0 0 four 0\n")
    with pytest.raises(ValueError, match=r"a\.walls:2: '0 0 four 0', expected a wall as four numbers"):
        read_walls(path)
    assert read_walls(tmp_path / "none.walls").shape == (0, 4)


def test_a_track_file_becomes_a_crossing_of_its_scene(tmp_path):
    scenario = TrackFile(write_tracks(tmp_path / "a.txt"))
    for seed in range(10):
        spec = scenario.spawn(np.random.default_rng(seed))
        assert 5.9 <= math.dist(spec.start_pose[:2], spec.goal) <= 12.1
        assert spec.collision_distance_m == 0.18 and spec.time_limit_s == 90.0


def test_hermes_is_crossed_from_one_end_to_the_other(data_dir):
    scenario = make_scenario("hermes:bo-360-050-050", data_dir)
    ends = set()
    for seed in range(20):
        spec = scenario.spawn(np.random.default_rng(seed))
        assert abs(spec.start_pose[1]) == 6.0 and spec.goal[1] == -spec.start_pose[1]
        assert 0.0 < spec.start_pose[0] < 3.6
        assert spec.replay is not None and spec.replay.start_s >= 0.1 * spec.replay.recording.duration_s
        ends.add(spec.start_pose[1])
    assert ends == {-6.0, 6.0}
    with pytest.raises(ValueError, match="bo-360-050-050"):
        make_scenario("hermes:nowhere", data_dir)
