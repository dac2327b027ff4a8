"""Legs as a lidar at shin height sees them: simulated people beside those of real scans, by one and the same extractor.

python benchmarks/legs.py --data FOLDER [--png FILE] [--json FILE]

FOLDER holds `leg_tracker/` (Leigh, Pineau, Olmedo, Zhang, Person Tracking and Following with 2D Laser Scanners, ICRA
2015), whose `*_extracted.npz` have scans of people walking alone and the places of their legs' clusters.
"""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse.csgraph import connected_components

from densecavoid.frames import CameraConfig, LidarConfig
from densecavoid.perception.evaluation.legs import people_of
from densecavoid.perception.leg_recordings import LegRecording, labelled_legs
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import STANDING, TRAVERSING, sample_bodies
from densecavoid.sim.spec import Crowd, WorldSpec
from densecavoid.sim.world import SimConfig, Simulator

LINK_M = 0.13
"""Returns nearer than this to each other belong to one cluster, as in the recordings' own labels."""
MIN_RETURNS = 5
PERSON_M = 0.45
"""A cluster whose centre is this near to a person is one of their legs, or both."""
NEAREST_M = 0.9
"""Nearer people are left out: the scanner sees parts of its own vehicle there."""
PERCENTILES = (5, 25, 50, 75, 95)


@dataclass(frozen=True)
class Legs:
    """What the extractor found in a set of scans."""

    width_m: Float[np.ndarray, "clusters"]
    separation_m: Float[np.ndarray, "pairs"]
    """Of people who show two clusters."""
    shown: Int[np.ndarray, "people"]
    """Clusters that each person shows: one where the legs are side by side, or one behind the other."""

    @property
    def single(self) -> float:
        """Share of people who show one cluster."""
        return float((self.shown == 1).mean())


def clusters(
    ranges_m: Float[np.ndarray, "rays"], angles_rad: Float[np.ndarray, "rays"], place: Float[np.ndarray, "2"]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n"]]:
    """Clusters of a scan near a place: their centres in the scanner's frame, their widths from first to last return."""
    hit = np.isfinite(ranges_m) & (ranges_m > 0)
    points = (ranges_m * np.stack([np.cos(angles_rad), np.sin(angles_rad)]))[:, hit].T
    points = points[np.hypot(*(points - place).T) < PERSON_M + 0.5]
    apart = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    count, label = connected_components(apart < LINK_M)
    parts = [part for part in (points[label == k] for k in range(count)) if len(part) >= MIN_RETURNS]
    centres = np.array([part.mean(axis=0) for part in parts]).reshape(-1, 2)
    widths = np.array([np.hypot(*(part[-1] - part[0])) for part in parts])
    legs = np.hypot(*(centres - place).T) < PERSON_M
    return centres[legs], widths[legs]


def measure(
    scans_m: Float[np.ndarray, "people rays"],
    angles_rad: Float[np.ndarray, "rays"],
    places: Float[np.ndarray, "people 2"],
) -> Legs:
    """Legs of people at known places, each in a scan of their own or in the same scan again."""
    widths, separations, shown = [], [], []
    for ranges, place in zip(scans_m, places, strict=True):
        centres, width = clusters(ranges, angles_rad, place)
        widths.extend(width)
        shown.append(len(centres))
        if len(centres) == 2:
            separations.append(np.hypot(*(centres[1] - centres[0])))
    return Legs(np.array(widths), np.array(separations), np.array(shown))


# -- real scans --------------------------------------------------------------------------------------------------------


def walkers(
    recording: LegRecording, half_window_s: float = 0.45
) -> tuple[Int[np.ndarray, "people"], Float[np.ndarray, "people 4"]]:
    """Everybody labelled who is seen long enough: in which scan, and x, y, vx, vy by least squares."""
    places = [people_of(labels) for labels in recording.labels]
    scans, rows = [], []
    for k, here in enumerate(places):
        near = np.flatnonzero(np.abs(recording.time_s - recording.time_s[k]) < half_window_s)
        for place in here:
            times, way = [], []
            for other in near:
                after = recording.time_s[other] - recording.time_s[k]
                distance = np.hypot(*(places[other] - place).T)
                if distance.min() < 0.3 + 1.6 * abs(after):
                    times.append(after)
                    way.append(places[other][distance.argmin()])
            if len(times) < 5:
                continue
            velocity, middle = np.polyfit(times, np.array(way), 1)
            if np.hypot(*middle) >= NEAREST_M:
                scans.append(k)
                rows.append([*middle, *velocity])
    return np.array(scans), np.array(rows).reshape(-1, 4)


# -- simulated scans ---------------------------------------------------------------------------------------------------


class Walkers:
    """A scenario of one walker before a scanner at the origin: each spawn is the next of the list.

    Nothing stands behind: in the recordings, too, four in five rays that pass beside a person return nothing.
    """

    name = "walkers"

    def __init__(self, rows: Float[np.ndarray, "people 4"], yaw_rad: float) -> None:
        self._rows, self._yaw, self._next = rows, yaw_rad, 0

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        x, y, vx, vy = self._rows[self._next % len(self._rows)].tolist()
        self._next += 1
        radius, height = sample_bodies(rng, 1)
        speed = np.hypot(vx, vy)
        crowd = Crowd(
            np.array([[x, y]]),
            np.array([[x + 100 * vx, y + 100 * vy]]),
            np.array([speed]),
            radius,
            height,
            np.array([TRAVERSING if speed > 0.05 else STANDING]),
        )
        return WorldSpec(self.name, FloorPlan(), (0.0, 0.0, self._yaw), (0.0, 3.0), crowd)


def simulate(lidar: LidarConfig, rows: Float[np.ndarray, "people 4"], yaw_rad: float = 0.0, seed: int = 0) -> Legs:
    """Legs of simulated people with those places and velocities, as a `real` scanner sees them whose middle ray looks
    along `yaw_rad`."""
    config = SimConfig(lidar=lidar, camera=CameraConfig(width=4, height=4), sensors="real", threads=1)
    simulator = Simulator(Walkers(rows, yaw_rad), len(rows), config)
    simulator.reset(seed * len(rows) + np.arange(len(rows)))
    scans = simulator.sense().scan_m
    return measure(scans, yaw_rad + lidar.angles_rad, rows[:, :2])


def compare(data: Path, repeats: int = 5) -> tuple[Legs, Legs]:
    """Legs of the real scans, and of people simulated at the same places with the same velocities, `repeats` each."""
    real, simulated = [], []
    for recording in labelled_legs(data):
        scans, rows = walkers(recording)
        real.append(measure(recording.scans_m[scans], recording.angles_rad, rows[:, :2]))
        simulated.append(simulate(recording.lidar, np.tile(rows, (repeats, 1)), recording.yaw_rad))
    return _pooled(real), _pooled(simulated)


def _pooled(parts: list[Legs]) -> Legs:
    names = ("width_m", "separation_m", "shown")
    return Legs(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


# -- side by side ------------------------------------------------------------------------------------------------------


def table(legs: dict[str, Legs]) -> str:
    """Percentiles of what was measured, a row for each source."""
    lines = [f"{'':36}{'count':>7}" + "".join(f"{share:>7} %" for share in PERCENTILES)]
    for name in ("width_m", "separation_m"):
        for source, found in legs.items():
            values = getattr(found, name)
            shares = "".join(f"{value:9.3f}" for value in np.percentile(values, PERCENTILES))
            lines.append(f"{name.replace('_m', ' (m), ') + source:36}{len(values):7}" + shares)
    lines += [f"people who show one cluster, {source}: {found.single:.0%}" for source, found in legs.items()]
    return "\n".join(lines)


def picture(legs: dict[str, Legs], path: Path) -> None:
    """The two distributions, one panel each."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    panels = (
        ("width_m", "width of a leg's cluster (m)", 0.5),
        ("separation_m", "between a person's clusters (m)", 0.7),
    )
    for axis, (name, label, most) in zip(axes, panels, strict=True):
        for (source, found), colour in zip(legs.items(), ("#444444", "#d9723c"), strict=False):
            values = getattr(found, name)
            label_source = f"{source}: median {np.median(values):.3f} m"
            bins = np.linspace(0, most, 36).tolist()
            axis.hist(values, bins, density=True, histtype="step", color=colour, linewidth=1.8, label=label_source)
            axis.axvline(float(np.median(values)), color=colour, linewidth=1, linestyle=":")
        axis.set_xlabel(label)
        axis.set_yticks([])
        axis.spines[["top", "right", "left"]].set_visible(False)
        axis.legend(frameon=False)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("DENSECAVOID_DATA", "../shared/data")))
    parser.add_argument("--png", type=Path, help="file for a picture of the distributions")
    parser.add_argument("--json", type=Path, help="file for the figures")
    args = parser.parse_args()
    if not (args.data / "leg_tracker").is_dir():
        print(f"legs beside real scans: skipped, there is no leg_tracker/ in {args.data}")
        return
    real, simulated = compare(args.data)
    legs = {"real": real, "simulated": simulated}
    print(table(legs))
    if args.png:
        picture(legs, args.png)
    if args.json:
        record = {
            source: {
                "width_m": float(np.median(found.width_m)),
                "separation_m": float(np.median(found.separation_m)),
                "single": found.single,
            }
            for source, found in legs.items()
        }
        args.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
