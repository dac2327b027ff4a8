"""Simulated crowds beside real ones: speed and distances against density in one-way and two-way corridors, and lanes.

python benchmarks/crowds.py [--data PATH] [--motion anticipation] [--json FILE] [--png FILE] [--seconds 40]

The corridor is 3 m wide and closed to a ring: who leaves at one end comes in at the other, and sees and touches the
people there. Free speeds are those of the recorded people, N(1.55, .18) m/s. Both crowds are measured alike: density
is the number of people in a stretch of 4 m over its area, speed that of the displacement over 1 s, and the nearest
neighbour is looked for in the whole corridor.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from densecavoid.frames import Command
from densecavoid.scenarios.recordings import hermes_path, hermes_width_m, load_recording, resolve_data
from densecavoid.sim.config import SimConfig
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import ABSENT, TRAVERSING, sample_bodies
from densecavoid.sim.spec import Crowd, WorldSpec
from densecavoid.sim.world import Simulator

WIDTH_M, LENGTH_M, STRETCH_M = 3.0, 16.0, 4.0
FREE_SPEED = (1.55, 0.18)
DENSITIES = (0.4, 0.6, 0.85, 1.1, 1.35, 1.6, 1.85, 2.1, 2.35, 2.6)
BIN = 0.25
"""Width of a bin of density, people per m2, as in fundamental_diagram.json."""
SEAM_M = 6.0
"""So far across the ring's seam people see one another."""
WARM_UP_S, EVERY_S, SPEED_OVER_S = 15.0, 0.5, 1.0
DT_S = 0.05
LANE_M = 0.3
RECORDED_TWO_WAY = ("bo-360-090-090", "boa-300-065-105", "boa-300-080-120", "bot-360-120-120", "bot-360-160-160")


@dataclass(frozen=True)
class Ring:
    """A corridor with people everywhere in it, and an empty slot for the image of each beyond the seam."""

    density: float
    two_way: bool

    @property
    def name(self) -> str:
        return "ring"

    @property
    def people(self) -> int:
        return round(self.density * WIDTH_M * LENGTH_M)

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        plan, count = FloorPlan(), self.people
        for y in (-0.05, WIDTH_M + 0.05):
            plan.wall(-SEAM_M, y, LENGTH_M + SEAM_M, y)
        # Far from the ring and from each other: `RingSimulator` puts them into it, a dense crowd without room for all.
        pos = np.stack([1e3 + 2.0 * np.arange(2 * count), np.zeros(2 * count)], axis=1)
        way = np.where(rng.permutation(count) % 2 == 1, -1.0, 1.0) if self.two_way else np.ones(count)
        goal = pos + np.stack([1e4 * np.tile(way, 2), np.zeros(2 * count)], axis=1)
        speed = np.clip(rng.normal(*FREE_SPEED, count), 0.5, 2.2)
        radius, height = sample_bodies(rng, count)
        kind = np.full(count, TRAVERSING)
        crowd = Crowd(
            pos,
            goal,
            np.tile(speed, 2),
            np.tile(radius, 2),
            np.tile(height, 2),
            np.tile(kind, 2),
        )
        return WorldSpec(self.name, plan, (-100.0, 0.0, 0.0), (-200.0, 0.0), crowd, time_limit_s=1e6)

    def places(self, rng: np.random.Generator) -> np.ndarray:
        """Where people begin, [people, 2]: each at the best of some random places, so that few overlap."""
        pos = np.zeros((0, 2))
        while len(pos) < self.people:
            tries = rng.uniform([0.0, 0.35], [LENGTH_M, WIDTH_M - 0.35], (12, 2))
            off = np.abs(tries[:, None] - pos)
            off[..., 0] = np.minimum(off[..., 0], LENGTH_M - off[..., 0])
            room = np.hypot(off[..., 0], off[..., 1]).min(axis=1, initial=9.0)
            pos = np.vstack([pos, tries[np.argmax(room)]])
        return pos


class RingSimulator:
    """Some rings at once. The images of people near the seam walk as they do, and are put back after each step."""

    def __init__(self, ring: Ring, worlds: int, motion: str, seed: int = 0) -> None:
        config = SimConfig(control_dt_s=DT_S, physics_dt_s=DT_S, threads=1, motion=motion)  # type: ignore[arg-type]
        self.simulator = Simulator(ring, worlds, config)
        self.simulator.reset(seed + np.arange(worlds))
        self.count, self.worlds = ring.people, worlds
        state = self.simulator._state
        for b in range(worlds):
            state.pos[b, : self.count] = ring.places(np.random.default_rng((seed, b)))
        state.person_goal[:, : self.count, 1] = state.pos[:, : self.count, 1]
        self.way = np.sign(state.vel[:, : self.count, 0])
        self._still = Command(np.zeros(worlds), np.zeros(worlds))
        self.laps = np.zeros((worlds, self.count))
        self._mirror()

    @property
    def pos(self) -> np.ndarray:
        """Where everybody is, [worlds, people, 2]."""
        return self.simulator._state.pos[:, : self.count]

    @property
    def unwrapped(self) -> np.ndarray:
        """The same with the laps that each has gone."""
        return self.pos + np.stack([self.laps * LENGTH_M, np.zeros_like(self.laps)], axis=2)

    def step(self) -> None:
        self.simulator.step(self._still)
        lap = np.floor(self.pos[..., 0] / LENGTH_M)
        self.laps += lap
        self.pos[..., 0] -= lap * LENGTH_M
        self._mirror()

    def _mirror(self) -> None:
        state, n = self.simulator._state, self.count
        before = self.pos[..., 0] < SEAM_M
        near = before | (self.pos[..., 0] > LENGTH_M - SEAM_M)
        state.behaviour[:, n:] = np.where(near, TRAVERSING, ABSENT)
        state.pos[:, n:] = self.pos
        state.pos[:, n:, 0] += np.where(before, LENGTH_M, -LENGTH_M)
        state.vel[:, n:], state.heading[:, n:] = state.vel[:, :n], state.heading[:, :n]


@dataclass
class Samples:
    """One row for each person in a stretch at a moment: density of the stretch, speed, distance to the nearest."""

    density: np.ndarray
    speed: np.ndarray
    nearest_m: np.ndarray

    def bin(self, low: float) -> dict[str, float]:
        """Their mean density and speed and percentiles of the nearest neighbour's distance in a bin of density."""
        inside = (self.density >= low) & (self.density < low + BIN) & np.isfinite(self.speed)
        if not inside.any():
            return {"n": 0}
        p01, p10, p50 = np.percentile(self.nearest_m[inside], [1, 10, 50])
        row = {"n": int(inside.sum()), "rho": self.density[inside].mean(), "v_mean": self.speed[inside].mean()}
        return {key: float(value) for key, value in (row | {"nn_p01": p01, "nn_p10": p10, "nn_p50": p50}).items()}


def join(parts: list[Samples]) -> Samples:
    """All of them."""
    return Samples(*(np.concatenate([getattr(part, name) for part in parts]) for name in Samples.__annotations__))


def lane_order(across_m: np.ndarray, way: np.ndarray, rng: np.random.Generator) -> tuple[float, float]:
    """How much people are in lanes (1: fully), and the same with everybody's direction dealt anew.

    The mean over people of ((same - opposite) / (same + opposite))^2, counted among those who walk at most .3 m to the
    side of them (Rex and Loewen 2007).
    """
    beside = np.abs(across_m[:, None] - across_m[None]) < LANE_M
    np.fill_diagonal(beside, False)
    others = beside.sum(axis=1)

    def order(way: np.ndarray) -> float:
        balance = (beside * way[:, None] * way[None]).sum(axis=1)[others > 0] / others[others > 0]
        return float((balance**2).mean()) if balance.size else np.nan

    return order(way), float(np.mean([order(rng.permutation(way)) for _ in range(5)]))


def simulate(
    ring: Ring, worlds: int, seconds: float, motion: str, seed: int = 0
) -> tuple[Samples, np.ndarray, RingSimulator]:
    """Samples of some rings after they have warmed up, and rows of (lane order, the same of shuffled people)."""
    rings, rng = RingSimulator(ring, worlds, motion, seed), np.random.default_rng(0)
    parts, lanes = [], []
    lag, every = round(SPEED_OVER_S / 2 / DT_S), round(EVERY_S / DT_S)
    track = [rings.unwrapped]
    for step in range(1, round((WARM_UP_S + seconds) / DT_S) + 1):
        rings.step()
        track.append(rings.unwrapped)
        if step * DT_S < WARM_UP_S or step % every:
            continue
        then, speed = track[-1 - lag], np.hypot(*((track[-1] - track[-1 - 2 * lag]) / SPEED_OVER_S).transpose(2, 0, 1))
        for b in range(worlds):
            x, y = then[b, :, 0] % LENGTH_M, then[b, :, 1]
            shifted = np.concatenate([np.stack([x + k * LENGTH_M, y], axis=1) for k in (-1, 0, 1)])
            nearest = KDTree(shifted).query(np.stack([x, y], axis=1), k=2)[0][:, 1]
            stretch = (x // STRETCH_M).astype(int)
            density = np.bincount(stretch, minlength=4)[stretch] / (STRETCH_M * WIDTH_M)
            parts.append(Samples(density, speed[b], nearest))
            if ring.two_way:
                lanes += [lane_order(y[stretch == k], rings.way[b][stretch == k], rng) for k in range(4)]
    return join(parts), np.array(lanes).reshape(-1, 2), rings


def recorded(data: Path, runs: tuple[str, ...]) -> tuple[Samples, float, float]:
    """The same figures of recorded runs: samples, lane order, the same of shuffled people."""
    rng, parts, lanes = np.random.default_rng(0), [], []
    for run in runs:
        recording, width = load_recording(hermes_path(data, run), "hermes"), hermes_width_m(data, run)
        half = round(SPEED_OVER_S / 2 / recording.dt_s)
        for step in range(half, recording.num_steps - half, round(EVERY_S / recording.dt_s)):
            person, state = recording.at(step)
            before, after = (dict(zip(*pair, strict=True)) for pair in map(recording.at, (step - half, step + half)))
            inside = np.abs(state[:, 1]) < STRETCH_M / 2
            if inside.sum() < 2:
                continue
            speed = [
                np.hypot(*(after[p][:2] - before[p][:2])) / SPEED_OVER_S if p in before and p in after else np.nan
                for p in person[inside]
            ]
            nearest = KDTree(state[:, :2]).query(state[inside, :2], k=2)[0][:, 1]
            density = np.full(inside.sum(), inside.sum() / (STRETCH_M * width))
            parts.append(Samples(density, np.array(speed), nearest))
            lanes.append(lane_order(state[inside, 0], np.sign(state[inside, 3]), rng))
    order, shuffled = np.nanmean(lanes, axis=0)
    return join(parts), float(order), float(shuffled)


def compare(rows: list[dict[str, float]], samples: Samples) -> list[dict[str, float]]:
    """Each recorded bin of density from .4 to 2.6 per m2 with the simulated figures of the same bin."""
    table = []
    for row in rows:
        if 0.25 <= row["rho_lo"] <= 2.5:
            ours = samples.bin(row["rho_lo"])
            if ours["n"] >= 30:
                keys = ("rho_lo", "rho", "v_mean", "nn_p01", "nn_p10", "nn_p50")
                table.append({**{f"recorded_{key}": row[key] for key in keys}, **ours})
    return table


def print_table(title: str, table: list[dict[str, float]]) -> None:
    """Simulated beside recorded."""
    print(f"{title}\n  per m2    speed m/s (recorded)       nearest neighbour m: median (rec.)     p01 (rec.)")
    for row in table:
        speed, nearest = row["v_mean"] / row["recorded_v_mean"] - 1, row["nn_p50"] / row["recorded_nn_p50"] - 1
        print(
            f"  {row['rho']:.2f}      {row['v_mean']:.2f} ({row['recorded_v_mean']:.2f}) {speed:+6.1%}        "
            f"{row['nn_p50']:.2f} ({row['recorded_nn_p50']:.2f}) {nearest:+6.1%}                "
            f"{row['nn_p01']:.2f} ({row['recorded_nn_p01']:.2f})"
        )


def draw(path: Path, tables: dict[str, list[dict[str, float]]], rings: RingSimulator, motion: str) -> None:
    """The curves beside the recorded ones, and the two-way crowd from above."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Ellipse

    from densecavoid.viz import theme

    def colour(rgb: tuple[int, int, int]) -> tuple[float, float, float]:
        return rgb[0] / 255, rgb[1] / 255, rgb[2] / 255

    figure = Figure(figsize=(11, 8.4), facecolor=colour(theme.PAGE), layout="constrained")
    axes = figure.subplot_mosaic(
        [["one-way", "two-way"], ["near", "near 2"], ["above", "above"]], height_ratios=[4, 3, 3]
    )
    ways = {"one-way": theme.ROBOT, "two-way": theme.PERSON}
    panels = (
        ("v_mean", "speed (m/s)", 0.1, ("one-way", "two-way")),
        ("nn_p50", "nearest neighbour (m)", 0.15, ("near", "near 2")),
    )
    for key, label, band, names in panels:
        for name, (way, tint) in zip(names, ways.items(), strict=True):
            axis, table = axes[name], tables[way]
            real = np.array([[row["recorded_rho"], row[f"recorded_{key}"]] for row in table])
            ours = np.array([[row["rho"], row[key]] for row in table])
            axis.fill_between(
                real[:, 0], (1 - band) * real[:, 1], (1 + band) * real[:, 1], color=colour(theme.BORDER), lw=0
            )
            axis.plot(*real.T, color=colour(theme.MUTED), lw=1.5, label=f"recorded (HERMES), band ±{band:.0%}")
            axis.plot(*ours.T, "o-", color=colour(tint), lw=2, ms=5, label=f"simulated, {motion}")
            if key == "nn_p50":
                axis.plot(
                    [row["recorded_rho"] for row in table],
                    [row["recorded_nn_p01"] for row in table],
                    ":",
                    color=colour(theme.MUTED),
                )
                axis.plot(
                    ours[:, 0], [row["nn_p01"] for row in table], ":", color=colour(tint), label="first percentile"
                )
            axis.set_ylim(bottom=0)
            axis.set_xlim(0.2, 2.8)
            axis.set_ylabel(label, color=colour(theme.INK))
            if key == "v_mean":
                axis.set_title(f"{way} corridor", color=colour(theme.INK), loc="left", fontweight="bold")
            else:
                axis.set_xlabel("people per m²", color=colour(theme.INK))
            axis.legend(frameon=False, fontsize=8, labelcolor=colour(theme.INK))
            axis.set_facecolor(colour(theme.CARD))
            axis.tick_params(colors=colour(theme.MUTED))
            axis.grid(color=colour(theme.GRID))
            for spine in axis.spines.values():
                spine.set_color(colour(theme.BORDER))
    above, state = axes["above"], rings.simulator._state
    above.set_title(
        "two-way, 1.1 per m²: blue walk to the right, orange to the left", color=colour(theme.INK), loc="left"
    )
    for y in (0.0, WIDTH_M):
        above.axhline(y, color=colour(theme.WALL), lw=3)
    for i in range(rings.count):
        tint = theme.ROBOT if rings.way[0, i] > 0 else theme.PERSON
        (x, y), radius, turn = state.pos[0, i], state.radius[0, i], np.degrees(state.heading[0, i])
        body = Ellipse((x, y), 1.1 * radius, 2 * radius, angle=turn, color=colour(tint), alpha=0.85, lw=0)
        above.add_patch(body)
        above.plot(x, y, "o", ms=3, color=colour(theme.CARD))
    above.set(xlim=(0, LENGTH_M), ylim=(-0.1, WIDTH_M + 0.1), aspect="equal")
    above.axis("off")
    figure.savefig(path, dpi=110, facecolor=figure.get_facecolor())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--data", type=Path, help="folder of the recordings; else DENSECAVOID_DATA")
    parser.add_argument("--motion", default="anticipation", help="anticipation, social-force or orca")
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--png", type=Path, help="file for the picture")
    parser.add_argument("--seconds", type=float, default=30.0, help="simulated for each density")
    parser.add_argument("--worlds", type=int, default=2, help="rings for each density")
    args = parser.parse_args()
    data = resolve_data(args.data)
    diagram = json.loads((data / "hermes" / "fundamental_diagram.json").read_text(encoding="utf-8"))
    result: dict[str, object] = {"motion": args.motion, "free_speed": FREE_SPEED, "width_m": WIDTH_M}
    tables, shown, lanes = {}, None, []
    for way, key in (("one-way", "uni"), ("two-way", "bi")):
        parts = []
        for density in DENSITIES:
            samples, orders, rings = simulate(Ring(density, way == "two-way"), args.worlds, args.seconds, args.motion)
            parts.append(samples)
            if way == "two-way":
                lanes.append(
                    {"density": density, "order": np.nanmean(orders[:, 0]), "shuffled": np.nanmean(orders[:, 1])}
                )
                shown = rings if density <= 1.1 else shown
        tables[way] = compare(diagram[key], join(parts))
        print_table(f"{way}, {args.motion}", tables[way])
        result[way.replace("-", "_")] = tables[way]
    _, order, shuffled = recorded(data, RECORDED_TWO_WAY)
    result["lanes"] = {"simulated": lanes, "recorded_order": order, "recorded_shuffled": shuffled}
    print(f"lanes: order {order:.2f} recorded ({shuffled:.2f} if directions were dealt anew)")
    for row in lanes:
        print(f"  {row['density']:.2f} per m2: order {row['order']:.2f} simulated ({row['shuffled']:.2f} dealt anew)")
    if args.png and shown is not None:
        draw(args.png, tables, shown, args.motion)
    if args.json:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        args.json.write_text(json.dumps(result, indent=1, default=float) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
