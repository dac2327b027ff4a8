"""How well people are tracked in simulated crowds, and how the tracker's settings were found.

python benchmarks/tracking.py [--source network|noisy-truth] [--no-legs] [--cost] [--tune] [--json FILE]

Without `--tune`: scores in the test scenarios. With it: settings for worlds of training, changed one after the other
for as long as that helps; nothing of the tests is looked at.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path

from densecavoid.baselines import GoToGoal
from densecavoid.perception.detector.worlds import training_rooms, training_worlds
from densecavoid.perception.evaluation.tracker import (
    Moment,
    TrackingRun,
    evaluate_tracker,
    follow,
    record,
    score,
    summary,
)
from densecavoid.perception.evaluation.tracking_cost import tracking_cost
from densecavoid.perception.evaluation.tracking_sources import NoisyTruthSource
from densecavoid.perception.sources import ImageSource
from densecavoid.perception.tracker_settings import TrackerSettings

Part = tuple[Sequence[Moment], TrackingRun]

SOURCES = ("network", "noisy-truth")
PROMISED = ("confirmed", "gain_bias", "max_unseen_s")
"""Not searched: by how many detections somebody is sure, and how long somebody hidden is remembered, are promises."""
FACTORS = (0.7, 1.4)
"""By which each setting is changed in turn; those around 0 are moved by the same shares of a unit."""
FALSE_WEIGHT = 0.2
"""What a false track at each instant of a furnished room without people costs of the objective."""
LEAST_GAIN = 5e-4
"""Of the objective, from which a change is kept."""


def objective(scores: dict[str, float]) -> float:
    """The mean of MOTA and IDF1, over all who have been visible and over those in view."""
    return sum(scores[name] for name in ("mota", "idf1", "mota_in_view", "idf1_in_view")) / 4


def tune(crowds: Part, rooms: Part, rounds: int = 2) -> TrackerSettings:
    """Settings by coordinate descent from the shipped ones.

    Args:
        crowds: a recording of worlds with people.
        rooms: one of furnished rooms without anybody, where each false track counts.
    """

    def reached(settings: TrackerSettings) -> float:
        false = score(follow(*rooms, settings)).false / (rooms[1].steps * rooms[1].worlds)
        return objective(summary([crowds], settings)) - FALSE_WEIGHT * false

    best = TrackerSettings()
    most = reached(best)
    print(f"start: {most:.4f}", flush=True)
    for _ in range(rounds):
        before = most
        for name in (name for name in TrackerSettings._fields if name not in PROMISED):
            for factor in FACTORS:
                value = getattr(best, name)
                changed = value + factor - 1.0 if abs(value) <= 1.0 and value <= 0.0 else value * factor
                trial = best._replace(**{name: changed})
                now = reached(trial)
                if now > most + LEAST_GAIN:
                    best, most = trial, now
                    print(f"{name} {value:.3g} -> {changed:.3g}: {most:.4f}", flush=True)
        if most == before:
            break
    print(best)
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--source", choices=SOURCES, default="network", help="of the camera's detections")
    parser.add_argument("--no-legs", action="store_true", help="the lidar takes no part")
    parser.add_argument("--worlds", type=int, default=8, help="of each scenario")
    parser.add_argument("--steps", type=int, default=200, help="control steps of each world")
    parser.add_argument("--seed", type=int, default=20_000, help="of the first world")
    parser.add_argument("--tune", action="store_true", help="search for better settings in worlds of training")
    parser.add_argument("--cost", action="store_true", help="time tracker and leg detector, too")
    parser.add_argument("--json", type=Path, help="file for the figures")
    args = parser.parse_args()
    run = TrackingRun(args.worlds, args.steps, args.seed, not args.no_legs)
    make = {
        "network": lambda: ImageSource(run.sim.camera, args.worlds),
        "noisy-truth": lambda: NoisyTruthSource(args.worlds),
    }
    source = make[args.source]()
    start = time.perf_counter()
    if args.tune:
        crowds, rooms = (
            (record(worlds, GoToGoal(), source, run), run) for worlds in (training_worlds(), training_rooms())
        )
        tables: dict = {"before": summary([crowds])}
        tables["settings"] = tune(crowds, rooms)._asdict()
        tables["after"] = summary([crowds], TrackerSettings(**tables["settings"]))
    else:
        tables = dict(evaluate_tracker(GoToGoal(), source, run=run))
        if args.cost:
            tables["cost"] = tracking_cost()
    print(json.dumps(tables, indent=1))
    print(f"{time.perf_counter() - start:.0f} s")
    if args.json:
        args.json.write_text(json.dumps(tables, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
