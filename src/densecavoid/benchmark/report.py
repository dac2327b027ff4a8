"""Tables, a plot and a page of a benchmark's results. Reads what the benchmark wrote, so that they can be made again at
any time."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from densecavoid.benchmark.charts import COLOURS
from densecavoid.benchmark.page import write_page
from densecavoid.benchmark.paper import PAPER_FROZEN, PAPER_PATH_M, PAPER_SUCCESS
from densecavoid.frames import require

INK, MUTED = "#1f2933", "#7b8794"

Cell = dict
"""One cell of results.json."""


def write_report(results: dict, out: Path) -> None:
    """Writes tables.md, success.png and index.html into a folder.

    Args:
        results: What `run_benchmark` returned, or what results.json holds.
        out: The folder, made if it is not there; the page shows what else the benchmark left in it.
    """
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    (out / "tables.md").write_text(tables(results), encoding="utf-8")
    plot_success(results, out / "success.png")
    write_page(results, out)


def report_of(folder: Path) -> None:
    """Makes the report of a folder's results.json again."""
    write_report(json.loads((Path(folder) / "results.json").read_text(encoding="utf-8")), folder)


def tables(results: dict) -> str:
    """All figures as Markdown: a group of tables for each question, navigators as rows and scenarios as columns."""
    cells: list[Cell] = results["cells"]
    require(len(cells) > 0, "cells of the results", cells, "at least one")
    parts = ["# Results", _conditions(results), *_worlds(results)]

    def add(title: str, text: Callable[[Cell], str]) -> None:
        parts.append(f"### {title}\n\n{_table(cells, text)}")

    parts.append("## Does it arrive?")
    add("Success", lambda cell: _rate(cell, "success", PAPER_SUCCESS))
    add("SPL (success weighted by path length)", lambda cell: _number(cell["spl"], 2))
    add(
        "Path length of successes (m)", lambda cell: _number(cell["path_length_m"], 2) + _paper(cell, PAPER_PATH_M, "m")
    )
    add("Time to goal of successes (s)", lambda cell: _number(cell["time_to_goal_s"], 1))
    add("Time to goal of successes, by the oracle's", lambda cell: _number(cell.get("time_over_reference"), 2))
    parts.append("## How does it fail?")
    add("Frozen", lambda cell: _rate(cell, "frozen", PAPER_FROZEN))
    add("Collision, at fault", lambda cell: _rate(cell, "collision_at_fault"))
    add("Collision, walked into", lambda cell: _rate(cell, "walked_into"))
    add("Timeout", lambda cell: _rate(cell, "timeout"))
    parts.append("## How does it move among people?")
    add("Least clearance to people (m, mean)", lambda cell: _number(cell["clearance_people_m"], 2))
    add("Share of time within .45 m of a person's body", lambda cell: _number(cell["personal_space"], 3))
    add("Mean absolute jerk (m/s³)", lambda cell: _number(cell["jerk_m_s3"], 2))
    add("Sign changes of w per metre", lambda cell: _number(cell["w_sign_changes_per_m"], 2))
    parts.append(_NOTES)
    return "\n\n".join(parts) + "\n"


def plot_success(results: dict, path: Path) -> None:
    """Draws success, a panel a scenario: a bar a navigator with its Wilson interval, the paper's value as a tick."""
    cells: list[Cell] = results["cells"]
    navigators, scenarios = _unique(cells, "navigator"), _unique(cells, "scenario")
    columns = min(4, len(scenarios))
    rows = -(-len(scenarios) // columns)
    panel_height = 0.75 + 0.36 * len(navigators)
    figure = Figure(figsize=(1.6 + 2.45 * columns, 0.75 + panel_height * rows), dpi=160, facecolor="white")
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True)
    for k, axes in enumerate(grid.flat):
        if k < len(scenarios):
            _success_panel(axes, cells, navigators, scenarios[k], name_navigators=k % columns == 0)
        else:
            axes.set_visible(False)
    episodes = min(cell["episodes"] for cell in cells)
    paper = any(_paper(cell, PAPER_SUCCESS) for cell in cells)
    figure.text(0.012, 0.985, "Success rate", ha="left", va="top", fontsize=12, color=INK)
    note = f"{episodes} episodes a bar, lines are 95 % intervals" + (", dark ticks are the paper's" if paper else "")
    figure.text(0.988, 0.982, note, ha="right", va="top", fontsize=8, color=MUTED)
    figure.tight_layout(rect=(0, 0, 1, 1 - 0.38 / figure.get_figheight()), h_pad=1.2, w_pad=1.4)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def _success_panel(axes: Axes, cells: list[Cell], navigators: list[str], scenario: str, name_navigators: bool) -> None:
    by_navigator = {cell["navigator"]: cell for cell in cells if cell["scenario"] == scenario}
    for row, navigator in enumerate(navigators):
        cell = by_navigator.get(navigator)
        if cell is None:
            continue
        value, (low, high) = cell["success"], cell["success_ci95"]
        axes.barh(row, 1.0, height=0.52, color="#f1f3f5", zorder=1)
        axes.barh(row, value, height=0.52, color=COLOURS[row % len(COLOURS)], zorder=2)
        axes.plot([low, high], [row, row], color=INK, linewidth=1.1, solid_capstyle="butt", zorder=3)
        axes.text(1.04, row, f"{value:.2f}", ha="left", va="center", fontsize=8.5, color=INK)
        paper = PAPER_SUCCESS.get(navigator, {}).get(scenario)
        if paper is not None:
            axes.plot([paper, paper], [row - 0.34, row + 0.34], color=INK, linewidth=2.2, zorder=4)
    axes.set_title(scenario, loc="left", fontsize=9, color=INK, pad=5)
    axes.set_xlim(0, 1.22)
    axes.set_ylim(len(navigators) - 0.5, -0.5)
    axes.set_xticks([])
    axes.set_yticks(range(len(navigators)), navigators if name_navigators else [""] * len(navigators))
    axes.tick_params(length=0, labelsize=9, labelcolor=INK)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _table(cells: list[Cell], text: Callable[[Cell], str]) -> str:
    navigators, scenarios = _unique(cells, "navigator"), _unique(cells, "scenario")
    by_place = {(cell["navigator"], cell["scenario"]): cell for cell in cells}
    privileged = {cell["navigator"] for cell in cells if cell["privileged"]}
    lines = ["| | " + " | ".join(scenarios) + " |", "|---" * (len(scenarios) + 1) + "|"]
    for navigator in navigators:
        name = f"{navigator} (privileged)" if navigator in privileged else navigator
        row = [by_place.get((navigator, scenario)) for scenario in scenarios]
        lines.append(f"| {name} | " + " | ".join("" if cell is None else text(cell) for cell in row) + " |")
    return "\n".join(lines)


def _conditions(results: dict) -> str:
    """What a table must name (BENCHMARK.md, Figures)."""
    cells = results["cells"]
    lines = [f"- definition {results['definition']}"]
    for name in ("people", "pace", "motion", "dynamics", "sensors", "episodes"):
        lines.append(f"- {name}: {', '.join(str(value) for value in _unique(cells, name))}")
    lines.append(f"- seeds: {', '.join(f'{first} to {last}' for first, last in _unique(cells, 'seeds'))}")
    for navigator in _unique(cells, "navigator"):
        digest = next(cell["policy_sha256"] for cell in cells if cell["navigator"] == navigator)
        if digest:
            lines.append(f"- policy of {navigator}: sha256 {digest}")
    return "\n".join(lines)


def _worlds(results: dict) -> list[str]:
    """How many of the worlds could be solved, and how quickly."""
    if not results.get("worlds"):
        return []
    lines = ["| scenario | can be solved | worlds driven in | oracle's time (s) |", "|---|---|---|---|"]
    for world in results["worlds"]:
        low, high = world["share_ci95"]
        share = f"{world['solvable']} of {world['tried']}: {world['share']:.2f} [{low:.2f}, {high:.2f}]"
        note = "" if world["filtered"] else ", the others too"
        lines.append(
            f"| {world['scenario']} | {share} | {world['admitted']}{note} | {_number(world['reference_time_s'], 1)} |"
        )
    return ["## Worlds\n\n" + "\n".join(lines)]


_NOTES = """## Notes

Rates with Wilson 95 % intervals in brackets; "paper" is what the paper printed for the same navigator, from about 15
trials. Frozen: a net displacement under .30 m in some 10 s before the goal, or, in robot-freezing, not past the people
30 s after they appeared. At fault: with a thing, or with a person whom the robot moved towards faster than .1 m/s in
the last .5 s; walked into: all other collisions. Clearances are from the robot's centre to a person's body.
A privileged navigator reads ground truth; `oracle` knows the future, and its time is the reference."""


def _rate(cell: Cell, name: str, paper: dict[str, dict[str, float]] | None = None) -> str:
    low, high = cell[f"{name}_ci95"]
    return f"{cell[name]:.2f} [{low:.2f}, {high:.2f}]" + (_paper(cell, paper) if paper else "")


def _paper(cell: Cell, values: dict[str, dict[str, float]], unit: str = "") -> str:
    value = values.get(cell["navigator"], {}).get(cell["scenario"])
    if value is None:
        return ""
    return f" (paper {value:.2f}{' ' + unit if unit else ''})"


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None or not np.isfinite(value) else f"{value:.{digits}f}"


def _unique(cells: list[Cell], name: str) -> list:
    """The values of a field in the order in which they come."""
    return list({json.dumps(cell[name]): cell[name] for cell in cells}.values())
