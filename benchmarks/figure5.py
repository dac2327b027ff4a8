"""Figure 5 of the paper again: reward against iterations, with the prediction frame and without, several seeds each.

python benchmarks/figure5.py --run [--seeds 3] [--steps 3000000] [--out runs/figure5]
    trains what is missing, then draws
python benchmarks/figure5.py [--out runs/figure5]
    draws what is there

A run that was stopped goes on where it was. Beside the reward the picture has how far the curriculum has come (sum of
the levels of all stages): the stages differ in the reward that can be had, and a run that is promoted loses some.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

SENSORS = {"densecavoid": "with prediction", "depth-lidar": "without prediction"}
SMOOTHING = 10
"""Iterations over which a curve is averaged."""


@dataclass(frozen=True)
class Curve:
    """One run: reward of the episodes that ended (NaN where none did) and progress of the curriculum, by iteration."""

    reward: Float[np.ndarray, "iterations"]
    progress: Float[np.ndarray, "iterations"]


def run_all(out: Path, seeds: int, steps: int, **changes: object) -> None:
    """Trains every (sensors, seed) whose run has not come to `steps`, in turn seed by seed."""
    from densecavoid.learning.config import TrainConfig
    from densecavoid.learning.run import resume, train
    from densecavoid.learning.run_folder import RunFolder

    for seed in range(seeds):
        for sensors in SENSORS:
            folder = out / f"{sensors}-{seed}"
            if not RunFolder(folder).config_file.exists():
                result = train(
                    TrainConfig(run_dir=folder, sensors=sensors, seed=seed, total_steps=steps, **changes)  # type: ignore[arg-type]
                )
            elif len(read_curve(folder).reward) == 0 or last_step(folder) < steps:
                result = resume(folder, total_steps=steps)
            else:
                continue
            if not result.finished:
                sys.exit(f"stopped; to go on, give the same command again (runs are in {out})")


def last_step(folder: Path) -> int:
    """Environment steps that a run has logged."""
    lines = (folder / "metrics.jsonl").read_text(encoding="utf-8").splitlines()
    return int(json.loads(lines[-1])["steps"]) if lines else 0


def read_curve(folder: Path) -> Curve:
    """From a run folder's log; empty where there is none yet."""
    file = folder / "metrics.jsonl"
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    records = [json.loads(line) for line in lines]
    reward = np.array([record.get("episode/return", np.nan) for record in records])
    levels = [[v for name, v in record.items() if name.startswith("curriculum/level/")] for record in records]
    return Curve(reward, np.array([sum(each) for each in levels], float))


def smooth(values: Float[np.ndarray, "iterations"], width: int = SMOOTHING) -> Float[np.ndarray, "iterations"]:
    """Mean over the last `width` values that are there."""
    known = np.isfinite(values)
    sums = np.cumsum(np.where(known, values, 0.0))
    counts = np.cumsum(known)
    earlier = np.arange(len(values)) - width
    sums_before = np.where(earlier >= 0, sums[earlier], 0.0)
    counts_before = np.where(earlier >= 0, counts[earlier], 0)
    number = counts - counts_before
    return np.where(number > 0, (sums - sums_before) / np.maximum(number, 1), np.nan)


def iterations_to(progress: Float[np.ndarray, "iterations"], wanted: float) -> int | None:
    """The first iteration at which the curriculum has come so far; None if it has not."""
    reached = np.flatnonzero(progress >= wanted)
    return int(reached[0]) + 1 if len(reached) else None


@dataclass(frozen=True)
class Verdict:
    """Which of two kinds of runs gets there first."""

    progress: float
    """What all runs have reached: the greatest such."""
    iterations: dict[str, list[int]]
    """Until then, of each run."""
    text: str


def judge(curves: dict[str, list[Curve]]) -> Verdict:
    """Whether prediction converges faster: only where every run with it is ahead of every run without."""
    common = min(curve.progress[-1] for runs in curves.values() for curve in runs)
    found = {
        sensors: [number for curve in runs if (number := iterations_to(curve.progress, common)) is not None]
        for sensors, runs in curves.items()
    }
    using, without = (found[sensors] for sensors in SENSORS)
    means = f"{np.mean(using):.0f} iterations with prediction, {np.mean(without):.0f} without"
    if max(using) < min(without):
        text = f"prediction converges faster in all runs ({means})"
    elif max(without) < min(using):
        text = f"prediction converges more slowly in all runs ({means})"
    else:
        text = f"no difference beyond the spread between seeds ({means})"
    return Verdict(float(common), found, text)


def draw(curves: dict[str, list[Curve]], path: Path) -> None:
    """Mean and spread (least to greatest) of both kinds of runs."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    from densecavoid.viz import theme

    colours = dict(zip(SENSORS, (theme.ROBOT, theme.PERSON), strict=True))
    figure, axes = pyplot.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    titles = ("reward of an episode", "progress: sum of the stages' levels")
    for axis, title, name in zip(axes, titles, ("reward", "progress"), strict=True):
        for sensors, runs in curves.items():
            length = min(len(curve.reward) for curve in runs)
            lines = np.array([getattr(curve, name)[:length] for curve in runs])
            if name == "reward":
                lines = np.array([smooth(line) for line in lines])
            colour = tuple(channel / 255 for channel in colours[sensors])
            iterations = np.arange(1, length + 1)
            label = f"{SENSORS[sensors]} ({len(runs)} seed{'s' if len(runs) > 1 else ''})"
            axis.plot(iterations, lines.mean(axis=0), color=colour, label=label)
            axis.fill_between(iterations, lines.min(axis=0), lines.max(axis=0), color=colour, alpha=0.2, linewidth=0)
        axis.set_title(title, fontsize=11)
        axis.set_xlabel("iterations")
        axis.grid(alpha=0.3)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].legend(frameon=False, loc="lower right")
    figure.savefig(path, dpi=130)
    pyplot.close(figure)


def main(args: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", action="store_true", help="train what is missing")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=3_000_000, help="environment steps of each run")
    parser.add_argument("--out", type=Path, default=Path("runs/figure5"))
    options = parser.parse_args(args)
    if options.run:
        if importlib.util.find_spec("torch") is None:
            sys.exit("training needs torch: pip install 'densecavoid[train]'")
        run_all(options.out, options.seeds, options.steps)
    curves = {
        sensors: [
            curve
            for seed in range(options.seeds)
            if len((curve := read_curve(options.out / f"{sensors}-{seed}")).reward)
        ]
        for sensors in SENSORS
    }
    if not all(curves.values()):
        print(f"{options.out} does not hold runs of both kinds: give --run to train them")
        return
    verdict = judge(curves)
    draw(curves, options.out / "figure5.png")
    (options.out / "figure5.json").write_text(json.dumps(asdict(verdict), indent=1) + "\n", encoding="utf-8")
    print(f"until a progress of {verdict.progress:g}: {verdict.text}\n{options.out / 'figure5.png'}")


if __name__ == "__main__":
    main()
