"""Real scans of people's legs: the recordings of Leigh, Pineau, Olmedo and Zhang (Person Tracking and Following with 2D
Laser Scanners, ICRA 2015), from a folder `leg_tracker/`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from densecavoid.frames import LidarConfig, require


@dataclass(frozen=True)
class LegRecording:
    """Scans of one scanner, with the labels that belong to them."""

    name: str
    lidar: LidarConfig
    yaw_rad: float
    """Where the middle of the scan looks, in the scanner's frame, which the labels are in."""
    time_s: Float[np.ndarray, "scans"]
    scans_m: Float[np.ndarray, "scans rays"]
    labels: list[Float[np.ndarray, "_ 2"]]
    """Of each scan; none where nothing is labelled."""

    @property
    def angles_rad(self) -> Float[np.ndarray, "rays"]:
        """Of each ray, in the scanner's frame."""
        return self.yaw_rad + self.lidar.angles_rad

    @property
    def pose(self) -> Float[np.ndarray, "scans 3"]:
        """The scanner's in its own frame, for each scan."""
        return np.tile([0.0, 0.0, self.yaw_rad], (len(self.time_s), 1))


def _recording(
    name: str, meta: tuple[float, ...], time_s: np.ndarray, scans_m: np.ndarray, labels: list[np.ndarray]
) -> LegRecording:
    angle_min, increment, range_min, range_max = meta
    fov = increment * (scans_m.shape[1] - 1)
    lidar = LidarConfig(scans_m.shape[1], min(fov, 2 * math.pi), range_max, range_min)
    return LegRecording(name, lidar, angle_min + fov / 2, time_s.astype(float), scans_m.astype(np.float32), labels)


def labelled_legs(data: Path) -> list[LegRecording]:
    """People walking alone before a standing scanner, and where each cluster of their legs is: `*_extracted.npz`.

    All is labelled that lies within 15 degrees of straight ahead and 5 m, and nothing elsewhere.

    Raises:
        ValueError: if there are none.
    """
    paths = sorted((data / "leg_tracker").glob("*_extracted.npz"))
    require(len(paths) > 0, "recordings", f"no leg_tracker/*_extracted.npz in {data}", "some")
    found = []
    for path in paths:
        with np.load(path) as file:
            labels = np.split(file["label_xy"].astype(np.float64), np.cumsum(file["label_n"])[:-1])
            meta, scans = tuple(file["training_scan_meta"].tolist()), file["training_scan_ranges"]
            found.append(_recording(path.stem, meta, file["training_scan_t"], scans, labels))
    return found


def followed_person(data: Path) -> LegRecording:
    """A robot follows a person outdoors: where that person is, in most scans. Others are not labelled."""
    path = data / "leg_tracker" / "person_following_outdoor_1.npz"
    with np.load(path) as file:
        truth, taken = file["gt"], file["scan_bagt"]
        scan = np.searchsorted(taken, truth[:, 0], side="right") - 1  # they belong to the scan just before
        labels = [truth[scan == k, 2:4] for k in range(len(taken))]
        return _recording(path.stem, tuple(file["meta"].tolist()), file["scan_t"], file["ranges"], labels)


def empty_rooms(data: Path) -> list[LegRecording]:
    """Nobody: rooms with furniture, from three scanners on a driving robot (a bag, without odometry).

    Raises:
        ValueError: if the package that reads bags is not there.
    """
    try:
        from rosbags.highlevel import AnyReader
    except ModuleNotFoundError:
        raise ValueError("reading bags needs rosbags: pip install 'densecavoid[robot]'") from None
    scans: dict[str, list] = {}
    with AnyReader([data / "leg_tracker" / "negative_2.bag"]) as reader:
        for connection, _, raw in reader.messages():
            if connection.msgtype == "sensor_msgs/msg/LaserScan":
                scans.setdefault(connection.topic, []).append(reader.deserialize(raw, connection.msgtype))
    found = []
    for topic, messages in sorted(scans.items()):
        first = messages[0]
        meta = (first.angle_min, first.angle_increment, first.range_min, first.range_max)
        time_s = np.array([m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in messages])
        ranges = np.stack([m.ranges for m in messages])
        found.append(_recording(f"negative_2{topic}", meta, time_s, ranges, [np.zeros((0, 2))] * len(messages)))
    return found


def half_of(recording: LegRecording, first: bool) -> LegRecording:
    """The first half of a recording, or the second."""
    half = len(recording.time_s) // 2
    part = slice(None, half) if first else slice(half, None)
    return LegRecording(
        recording.name,
        recording.lidar,
        recording.yaw_rad,
        recording.time_s[part],
        recording.scans_m[part],
        recording.labels[part],
    )
