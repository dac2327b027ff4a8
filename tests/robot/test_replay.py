"""Real recordings through the loop, and recordings that are none."""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from recordings import Kind, write_recording

from densecavoid.robot.bags import Bag, Topics
from densecavoid.robot.faults import ScriptedPilot
from densecavoid.robot.pilot import blank_frame
from densecavoid.robot.replay import ReplayConfig, replay


@pytest.fixture(scope="session")
def bags(data_dir: Path) -> Path:
    folder = data_dir / "leg_tracker"
    if not folder.is_dir():
        pytest.skip(f"no recordings of legs at {folder}")
    return folder


@pytest.fixture(scope="session")
def robot(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The recordings' vehicle: its scanners see parts of it up to .6 m away, and send 0 where nothing is in range."""
    path = tmp_path_factory.mktemp("robot") / "vehicle.yaml"
    path.write_text("zero_range: nothing\nignore_within_m: 0.6\nsafety: {max_linear_velocity: 0.65}\n")
    return str(path)


def test_a_moving_robots_scans_are_replayed_and_recorded(bags: Path, robot: str, tmp_path: Path) -> None:
    """negative_2: an empty room from a moving robot; its scanner sends 0 where nothing is in range."""
    config = ReplayConfig(bags / "negative_2.bag", robot=robot, out=tmp_path, max_seconds=8.0, record=True)
    summary = replay(config)
    assert 55 <= summary.scans <= 65 and summary.unreadable == 0
    assert summary.commands == pytest.approx(8.0 * 20, abs=4)
    rows = [json.loads(line) for line in (tmp_path / "commands.jsonl").read_text().splitlines()]
    assert len(rows) == summary.commands
    assert all(0 <= row["linear"] <= 0.65 and abs(row["angular"]) <= 0.4 for row in rows)
    decided = sum(
        count for reason, count in summary.reasons.items() if not reason.startswith(("no ", "scan", "policy"))
    )
    assert decided > 0.9 * summary.commands
    # What was written is what was decided, and opens as a recording again.
    from rosbags.highlevel import AnyReader

    with AnyReader([tmp_path / "recording"]) as reader:
        kinds = {c.topic: (c.msgtype, c.msgcount) for c in reader.connections}
        assert kinds["/scan"] == ("sensor_msgs/msg/LaserScan", summary.scans)
        assert kinds["/cmd_vel"] == ("geometry_msgs/msg/TwistStamped", summary.commands)
        connections = [c for c in reader.connections if c.topic == "/cmd_vel"]
        written: list[Any] = [
            reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(connections=connections)
        ]
    np.testing.assert_allclose([m.twist.linear.x for m in written], [row["linear"] for row in rows], atol=1e-4)
    # The recording goes through the loop as the bag did.
    again = replay(ReplayConfig(tmp_path / "recording", robot=robot, out=tmp_path / "again"))
    assert again.scans == summary.scans


def test_people_walking_in_front_of_a_standing_scanner_are_not_driven_into(
    bags: Path, robot: str, tmp_path: Path
) -> None:
    """positive_1: whenever a return is nearer ahead than the robot needs to stop, it is told to stop or slow down."""
    replay(ReplayConfig(bags / "positive_1.bag", robot=robot, out=tmp_path, max_seconds=25.0))
    rows = [json.loads(line) for line in (tmp_path / "commands.jsonl").read_text().splitlines()]
    with Bag(bags / "positive_1.bag") as bag:
        topics = bag.choose(Topics())
        assert topics.scan == "right_scan" and topics.odom == ""
        scans = [item for item in bag.messages(topics) if item.kind == "scan"]
    # The legs that walk there are followed, and the filter knows of them.
    assert max(len(row["people"]) for row in rows) >= 1
    first = scans[0].time_s
    checked = 0
    for item in scans:
        at = [row for row in rows if 0.0 <= row["time_s"] - (item.time_s - first) <= 0.05]
        ranges = np.asarray(item.message.ranges, float)
        angles = item.message.angle_min + item.message.angle_increment * np.arange(len(ranges))
        x, y = ranges * np.cos(angles), ranges * np.sin(angles)
        # Three returns in the strip ahead within .66 m: standing needs v .2 + v2 / 2 <= .66 - .18 - .08, so v <= .55.
        ahead = (ranges > 0.6) & (x > 0.0) & (x < 0.66) & (np.abs(y) < 0.2)
        if at and ahead.sum() >= 3:
            checked += 1
            assert at[0]["linear"] <= 0.55, (item.time_s - first, at[0])
    print(f"{checked} scans with something close ahead")


@pytest.mark.parametrize(
    ("kind", "compression"),
    [
        (".bag", "bz2"),
        (".bag", "lz4"),
        (".mcap", "storage"),
        (".mcap", "message"),
        (".db3", "message"),
        (".db3", "file"),
    ],
)
def test_compressed_recordings_are_read_and_those_that_unpack_to_too_much_are_refused(
    kind: Kind, compression: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frame = blank_frame(ScriptedPilot.lidar, ScriptedPilot.camera)
    path = write_recording(tmp_path / "drive", kind, [frame] * 5, compression=compression)

    def scans() -> int:
        with Bag(path) as bag:
            return sum(item.kind == "scan" for item in bag.messages(bag.choose(Topics()))) - bag.unreadable

    assert scans() == 5
    # As if few bytes stood for many: the limits are lower than what these few messages need.
    monkeypatch.setattr("densecavoid.robot.bag_limits.MAX_UNPACKED_BYTES", 200)
    size = path.stat().st_size if path.is_file() else sum(part.stat().st_size for part in path.iterdir())
    monkeypatch.setattr("densecavoid.robot.bags.MAX_BAG_BYTES", size)
    with pytest.raises(ValueError, match="unpacks to more than"):
        scans()


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        # A view that never ends where the version of the format is looked up.
        (
            "DROP TABLE schema; CREATE VIEW schema AS WITH RECURSIVE n(schema_version) AS "
            "(SELECT 0 UNION ALL SELECT schema_version + 1 FROM n) SELECT max(schema_version) AS schema_version FROM n",
            "schema",
        ),
        ("CREATE VIRTUAL TABLE other USING fts5(text)", "other"),
        # A gigabyte a message.
        (
            "ALTER TABLE messages RENAME TO before; CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, "
            "timestamp INTEGER, data BLOB AS (zeroblob(1000000000)))",
            "messages.data",
        ),
    ],
)
def test_databases_that_compute_are_refused(changes: str, named: str, tmp_path: Path) -> None:
    path = write_recording(tmp_path / "drive", ".db3", [blank_frame(ScriptedPilot.lidar, ScriptedPilot.camera)] * 2)
    file = path if path.is_file() else next(path.glob("*.db3"))
    with Bag(path) as bag:
        assert bag.topics_of("scan")
    with sqlite3.connect(file) as database:
        database.executescript(changes)
    for recording in {path, file}:
        with pytest.raises(ValueError, match=f"'{named}' in the database is computed"):
            Bag(recording)


@pytest.mark.parametrize(
    "content", [b"", b"#ROSBAG V2.0\n", b"#ROSBAG V2.0\n" + bytes(4000), b"\x89MCAP0\r\n" + bytes(99)]
)
def test_what_is_no_recording_is_refused_by_name(content: bytes, tmp_path: Path) -> None:
    for suffix in (".bag", ".mcap", ".db3"):
        path = tmp_path / f"broken{suffix}"
        path.write_bytes(content)
        with pytest.raises(ValueError, match="broken"):
            Bag(path)


def test_cut_and_scratched_bags_end_in_a_value_error_or_in_fewer_messages(bags: Path, tmp_path: Path) -> None:
    content = (bags / "positive_2_extracted.bag").read_bytes()
    rng = np.random.default_rng(5)
    for index in range(30):
        bad = bytearray(content)
        if index % 3 == 0:
            bad = bad[: int(rng.integers(len(bad)))]
        else:
            for place in rng.integers(0, min(len(bad), 20_000) if index % 3 == 1 else len(bad), 20):
                bad[place] = int(rng.integers(256))
        path = tmp_path / "scratched.bag"
        path.write_bytes(bad)
        try:
            with Bag(path) as bag:
                assert sum(1 for _ in bag.messages(bag.choose(Topics()))) <= 83
        except ValueError:
            pass
