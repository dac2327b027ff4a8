"""The drawings of the benchmark's page, as SVG: success against density, and many paths through one kind of world."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from html import escape

import numpy as np

from densecavoid.benchmark.statistics import wilson_interval

COLOURS = ("#2563eb", "#9aa5b1", "#168754", "#f08a4b", "#8b5cf6", "#c82d3c", "#0e9aa7", "#b58300", "#1f2933")
OUTCOME = {"success": "#168754", "collision": "#c82d3c", "timeout": "#8a949e"}
INK, MUTED, LINE = "#1f2933", "#66727f", "#e1e5ea"


def density_bins(densities: Sequence[float], bins: int = 5) -> list[float]:
    """Edges of bins with about as many worlds each; fewer where densities hardly differ."""
    edges = np.unique(np.quantile(densities, np.linspace(0, 1, bins + 1)).round(4))
    return edges.tolist()


def success_against_density(cells: dict[str, list[dict]], width: int = 560, height: int = 300) -> str | None:
    """A curve a navigator: success in bins of density, with 95 % intervals; None where densities do not vary.

    Args:
        cells: By navigator, the figures of its episodes (rows of `episodes.jsonl`).
        width, height: Of the drawing.
    """
    known = {
        name: [row for row in rows if row.get("density_per_m2") is not None and row["density_per_m2"] > 0.0]
        for name, rows in cells.items()
    }
    known = {name: rows for name, rows in known.items() if rows}
    if not known:
        return None
    edges = density_bins([row["density_per_m2"] for rows in known.values() for row in rows])
    if len(edges) < 3:
        return None
    left, right, top, bottom = 44, 150, 12, 40
    low, high = edges[0], edges[-1]

    def x(density: float) -> float:
        return left + (width - left - right) * (density - low) / (high - low)

    def y(rate: float) -> float:
        return top + (height - top - bottom) * (1.0 - rate)

    parts = [f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="Success against density">']
    for rate in (0, 0.25, 0.5, 0.75, 1):
        parts.append(_line(left, y(rate), width - right, y(rate), LINE))
        parts.append(_text(left - 6, y(rate) + 4, f"{rate:g}", "end"))
    for edge in edges:
        parts.append(_line(x(edge), y(0), x(edge), y(0) + 4, MUTED))
        parts.append(_text(x(edge), y(0) + 17, f"{edge:.2g}", "middle"))
    parts.append(_text((left + width - right) / 2, height - 4, "people per m² around the way", "middle"))
    ends: list[float] = []
    for k, (name, rows) in enumerate(known.items()):
        colour, points = COLOURS[k % len(COLOURS)], []
        for first, last in itertools.pairwise(edges):
            here = [
                row for row in rows if first <= row["density_per_m2"] and (row["density_per_m2"] < last or last == high)
            ]
            if not here:
                continue
            wins = sum(row["success"] for row in here)
            centre = float(np.mean([row["density_per_m2"] for row in here]))
            lower, upper = wilson_interval(wins, len(here))
            shift = 1.6 * (k - len(known) / 2)  # intervals of navigators beside each other
            points.append((x(centre) + shift, y(wins / len(here))))
            parts.append(_line(x(centre) + shift, y(lower), x(centre) + shift, y(upper), colour, 1.2))
        line = " ".join(f"{px:.1f},{py:.1f}" for px, py in points)
        parts.append(f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="2.2"/>')
        parts += [f'<circle cx="{px:.1f}" cy="{py:.1f}" r="3" fill="{colour}"/>' for px, py in points]
        at = points[-1][1] + 4
        while any(abs(at - other) < 13 for other in ends):
            at += 1
        ends.append(at)
        parts.append(_text(width - right + 12, at, escape(name), "start", colour))
    return "".join([*parts, "</svg>"])


def path_overlay(paths: Sequence[Sequence[Sequence[float]]], outcomes: Sequence[str], size: int = 240) -> str:
    """Paths of many episodes in one drawing, from a common start towards a common goal: turned and moved so that each
    starts at the left and has its goal to the right; coloured by how they ended.

    Args:
        paths: Places (x, y) in metres; the last entry of each is the goal.
        outcomes: One a path.
        size: Width of the drawing.
    """
    turned = []
    for path in paths:
        points = np.asarray(path, np.float64)
        way = points[-1] - points[0]
        cos, sin = way / max(float(np.hypot(*way)), 1e-6)
        rotation = np.array([[cos, sin], [-sin, cos]])
        turned.append((points - points[0]) @ rotation.T)
    everything = np.concatenate(turned)
    x_min, x_max = float(everything[:, 0].min()) - 0.4, float(everything[:, 0].max()) + 0.4
    half = max(float(np.abs(everything[:, 1]).max()) + 0.3, 0.18 * (x_max - x_min))
    scale = size / (x_max - x_min)
    height = 2 * half * scale
    parts = [f'<svg viewBox="0 0 {size} {height:.0f}" role="img" aria-label="Paths">']
    for way, outcome in sorted(zip(turned, outcomes, strict=True), key=lambda item: item[1] != "success"):
        points = " ".join(f"{(px - x_min) * scale:.1f},{(half - py) * scale:.1f}" for px, py in way[:-1])
        colour = OUTCOME[outcome]
        parts.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.1" opacity=".55"/>')
        px, py = way[-2]
        if outcome != "success":
            parts.append(
                f'<circle cx="{(px - x_min) * scale:.1f}" cy="{(half - py) * scale:.1f}" r="2.4" fill="{colour}"/>'
            )
    start = (-x_min * scale, half * scale)
    goal = (float(np.mean([way[-1][0] for way in turned])) - x_min) * scale
    parts.append(f'<circle cx="{start[0]:.1f}" cy="{start[1]:.1f}" r="4" fill="#fff" stroke="{INK}"/>')
    parts.append(f'<circle cx="{goal:.1f}" cy="{start[1]:.1f}" r="5" fill="#f5b800" stroke="#b58300"/>')
    return "".join([*parts, "</svg>"])


def _line(x0: float, y0: float, x1: float, y1: float, colour: str, width: float = 1.0) -> str:
    return f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" stroke="{colour}" stroke-width="{width}"/>'


def _text(x: float, y: float, text: str, anchor: str, colour: str = MUTED) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" font-size="12" fill="{colour}" text-anchor="{anchor}">{text}</text>'
