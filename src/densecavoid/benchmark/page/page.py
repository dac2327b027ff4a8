"""Puts the page together from what the benchmark left in its folder. Measures nothing, drives nowhere."""

from __future__ import annotations

import json
from collections.abc import Callable
from html import escape
from pathlib import Path

from densecavoid.benchmark.charts import path_overlay, success_against_density
from densecavoid.benchmark.compare import difference_of, load_episodes
from densecavoid.benchmark.paper import PAPER_FROZEN, PAPER_PATH_M, PAPER_SUCCESS
from densecavoid.benchmark.scenes import main_navigator

FOLDER = Path(__file__).parent

WORLDS = {
    "dense-static": "A room of 10 x 10 m full of boxes, pillars, tables and chairs. Nobody is there.",
    "random-sparse-ped": "A hall of 8 x 8 m in which ten people wander about and change their minds.",
    "dense-ped": "A corridor 4 m wide; fifteen people come slowly (.33 m/s) against the robot. Goal 15 m ahead.",
    "corridor-15": "The same corridor, the people faster (.5 m/s) and closer together. The hard one.",
    "robot-freezing": "A corridor; 3 or 4 people suddenly stand across the way, {} m ahead. A gap of 1 m stays free.",
    "hermes": "A recorded corridor walk: real people, walking as they did, who cannot see the robot.",
    "hermes:reactive": "The same recorded people, who keep their way in mind and make way for the robot.",
}
NAVIGATORS = {
    "densecavoid": "the paper's method: sees people, predicts where they will be, and steers by a learned policy",
    "depth": "the learned policy with the depth camera alone",
    "depth-lidar": "the learned policy with camera and lidar, but without prediction",
    "long2018": "a learned policy on the lidar alone (Long et al. 2018)",
    "go-to-goal": "drives straight at the goal and stops before what is in the way: the least one can do",
    "dwa": "on the way past what it has seen, tries arcs (dynamic window approach) among what the lidar sees, which it "
    "takes to stand still",
    "social-force": "is pulled along the way past what it has seen and pushed by people and walls",
    "orca": "on the way past what it has seen, picks a velocity that collides with nobody who keeps walking as they do",
    "orca-privileged": "the same, told by the simulator where everybody is and how they move",
    "lookahead": "plans the next 5.6 s among tracked people, who it takes to walk on, and what it has seen standing",
    "lookahead-privileged": "the same, told by the simulator where everybody is and how they move",
    "frozone": "densecavoid, turned away from where people would make it freeze",
    "oracle": "not a navigator but a yardstick: plans with knowledge of everybody's whole future",
}


def write_page(results: dict, out: Path) -> None:
    """Writes index.html from `results` and, as far as they are there, the other files of the benchmark's folder."""
    out = Path(out)
    episodes = load_episodes(out / "results.json") if (out / "episodes.jsonl").is_file() else {}
    paths = _json(out / "paths.json")
    scenes = _json(out / "scenes.json")
    cells = results["cells"]
    navigators = list(dict.fromkeys(cell["navigator"] for cell in cells))
    scenarios = list(dict.fromkeys(cell["scenario"] for cell in cells))
    table = _Table(cells, navigators, scenarios)
    body = [
        _opening(results, navigators),
        "<h2>Who arrives?</h2><p>Share of episodes that end at the goal without a collision, with the interval that "
        "holds the true rate 19 times of 20. A dark tick is what the paper reported for the same method, from about "
        "15 trials in worlds of its own.</p>",
        table.html(lambda cell: _rate(cell, "success", PAPER_SUCCESS)),
        "<h2>How do episodes end?</h2>",
        _key(
            {
                "at the goal": "--good",
                "collision at fault": "--fault",
                "walked into": "--walked",
                "no time left": "--time",
            }
        ),
        table.html(_ends),
        "<p><b>At fault</b>: the robot hit a thing, or a person towards whom it was moving. <b>Walked into</b>: "
        "somebody who does not see the robot walked into it while it stood or backed off the way.</p>",
        "<h2>Who freezes?</h2><p>A robot freezes when it finds every way too dangerous and stays where it is: less "
        "than .3 m of net movement in ten seconds, or, before people who suddenly stand in its way, not past them "
        "after half a minute. An episode may freeze for a while and still end well.</p>",
        table.html(lambda cell: _rate(cell, "frozen", PAPER_FROZEN)),
        _freezing(scenes),
        _densities(episodes, scenarios),
        _overlays(paths, episodes, scenarios, navigators),
        _films(scenes),
        _differences(episodes, navigators, scenarios),
        "<h2>How does it move?</h2><p>Time to the goal is compared with the oracle's in the same world (1 is as quick "
        "as with full knowledge). Personal space is the share of time within .45 m of somebody's body.</p>",
        table.html(_motion),
        _worlds(results),
        _conditions(results),
    ]
    html = f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width,initial-scale=1">
<title>DenseCAvoid: results</title><style>{(FOLDER / "page.css").read_text(encoding="utf-8")}</style></head>
<body><main>{"".join(body)}</main>
<script type="application/json" id="scenes">{json.dumps(scenes).replace("<", chr(92) + "u003c")}</script>
<script>{(FOLDER / "page.js").read_text(encoding="utf-8")}</script></body></html>
"""
    (out / "index.html").write_text(html, encoding="utf-8")


def _json(path: Path) -> list[dict]:
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else []


class _Table:
    """Navigators as rows, scenarios as columns."""

    def __init__(self, cells: list[dict], navigators: list[str], scenarios: list[str]) -> None:
        self._cells = {(cell["navigator"], cell["scenario"]): cell for cell in cells}
        self._navigators, self._scenarios = navigators, scenarios

    def html(self, text: Callable[[dict], str]) -> str:
        head = "".join(f"<th>{escape(name).replace(':', ':<br>')}</th>" for name in self._scenarios)
        rows = []
        for navigator in self._navigators:
            row = [self._cells.get((navigator, scenario)) for scenario in self._scenarios]
            sees = any(cell is not None and cell["privileged"] for cell in row)
            name = escape(navigator) + (' <span class="tag">sees the truth</span>' if sees else "")
            shown = "".join(f'<td class="num">{"" if cell is None else text(cell)}</td>' for cell in row)
            rows.append(f"<tr><th>{name}</th>{shown}</tr>")
        return f"<section><table><tr><th></th>{head}</tr>{''.join(rows)}</table></section>"


def _rate(cell: dict, name: str, paper: dict[str, dict[str, float]]) -> str:
    low, high = cell[f"{name}_ci95"]
    known = paper.get(cell["navigator"], {}).get(cell["scenario"])
    tick = "" if known is None else f'<b style="left:calc({100 * known:.0f}% - 1px)"></b>'
    said = "" if known is None else f'<span class="paper">paper {known:.2f}</span>'
    return (
        f'{cell[name]:.2f}<div class="bar"><i style="width:{100 * cell[name]:.0f}%"></i>{tick}</div>'
        f'<span class="range">{low:.2f} to {high:.2f}</span>{said}'
    )


def _ends(cell: dict) -> str:
    shares = {"good": "success", "fault": "collision_at_fault", "walked": "walked_into", "time": "timeout"}
    parts = "".join(
        f'<i style="width:{100 * cell[name]:.1f}%;background:var(--{colour})" title="{name} {cell[name]:.2f}"></i>'
        for colour, name in shares.items()
    )
    return f'<div class="stack">{parts}</div>'


def _motion(cell: dict) -> str:
    if cell["path_length_m"] is None:
        return '<span class="muted">never arrived</span>'
    ratio = cell.get("time_over_reference")
    paper = PAPER_PATH_M.get(cell["navigator"], {}).get(cell["scenario"])
    lines = [f"{cell['time_to_goal_s']:.1f} s" + ("" if ratio is None else f" ({ratio:.2f} x)")]
    lines.append(f"{cell['path_length_m']:.1f} m" + ("" if paper is None else f" (paper {paper:.1f})"))
    lines.append(f"personal space {100 * cell['personal_space']:.0f} %")
    lines.append(f"{cell['w_sign_changes_per_m'] or 0.0:.2f} turns/m")
    return "<br>".join(lines)


def _key(colours: dict[str, str]) -> str:
    return (
        '<p class="key">'
        + "".join(f'<span><i style="background:var({colour})"></i>{name}</span>' for name, colour in colours.items())
        + "</p>"
    )


def _opening(results: dict, navigators: list[str]) -> str:
    episodes = max(cell["episodes"] for cell in results["cells"])
    people = escape(", ".join(sorted({cell["people"] for cell in results["cells"]})))
    who = "".join(f"<dt>{escape(name)}</dt><dd>{NAVIGATORS.get(name, 'a policy file')}</dd>" for name in navigators)
    return (
        "<h1>Driving a robot through dense crowds</h1>"
        f"<p>A small robot (18 cm radius, at most 1 m/s, which turns slowly: at most .4 rad/s, a quarter turn in four "
        f"seconds) has to reach a place among people. Every way of driving it meets the same {episodes} worlds of each "
        f"kind. Each of these worlds can be solved: a planner that knows what everybody is going to do finds a way "
        f"through, so a failure is the driver's. People are <b>{people}</b>"
        + (": they avoid each other, but do not notice the robot." if people == "scripted" else ".")
        + f"</p><dl>{who}</dl>"
    )


def world_in_words(scenario: str) -> str:
    """What happens in the worlds of a scenario."""
    kind, _, rest = scenario.partition(":")
    if kind == "hermes" and rest.endswith(":reactive"):
        return WORLDS["hermes:reactive"]
    return WORLDS.get(kind, "A scenario of this package.").format(rest.replace("-", " to "))


def _worlds(results: dict) -> str:
    rows = []
    for world in results.get("worlds", []):
        share = f"{world['solvable']} of {world['tried']} ({100 * world['share']:.0f} %)"
        note = "" if world["filtered"] else " (all are driven in, solvable or not)"
        time = "" if world["reference_time_s"] is None else f"{world['reference_time_s']:.1f} s"
        said = escape(world_in_words(world["scenario"]))
        rows.append(
            f"<tr><th>{escape(world['scenario'])}</th><td>{said}</td><td>{share}{note}</td>"
            f"<td>{world['admitted']}</td><td>{time}</td></tr>"
        )
    return (
        "<h2>The worlds</h2><p>Worlds are drawn one after the other; those that even the planner with full knowledge "
        "cannot solve are left out. Its time is the yardstick for everybody else's.</p><section><table><tr><th></th>"
        "<th>what it is</th><th>can be solved</th><th>driven in</th><th>oracle's time</th></tr>"
        f"{''.join(rows)}</table></section>"
    )


def _conditions(results: dict) -> str:
    cells = results["cells"]
    said = {"definition": results["definition"], **results["versions"]}
    for name in ("people", "pace", "motion", "dynamics", "sensors", "episodes"):
        said[name] = ", ".join(dict.fromkeys(str(cell.get(name, "")) for cell in cells))
    said["seeds"] = ", ".join(dict.fromkeys(f"{first} to {last}" for first, last in (cell["seeds"] for cell in cells)))
    for cell in cells:
        if cell["policy_sha256"]:
            said[f"policy of {cell['navigator']}"] = cell["policy_sha256"]
    listed = "".join(f"<dt>{escape(name)}</dt><dd>{escape(str(value))}</dd>" for name, value in said.items())
    return f"<h2>Conditions</h2><dl>{listed}</dl>"


def _densities(episodes: dict[tuple[str, str], dict[int, dict]], scenarios: list[str]) -> str:
    groups = [[scenario] for scenario in scenarios if not scenario.startswith("hermes")]
    for reactive in (False, True):
        runs = [s for s in scenarios if s.startswith("hermes") and s.endswith(":reactive") == reactive]
        groups += [runs] if runs else []
    cards = []
    for group in groups:
        cells: dict[str, list[dict]] = {}
        for (navigator, scenario), rows in episodes.items():
            if scenario in group:
                cells.setdefault(navigator, []).extend(rows.values())
        curve = success_against_density(cells)
        if curve is not None:
            title = group[0] if len(group) == 1 else "recorded crowds" + (", reactive" if "react" in group[0] else "")
            cards.append(f'<div class="card"><h3>{escape(title)}</h3>{curve}</div>')
    if not cards:
        return ""
    return (
        "<h2>Success against density</h2><p>Worlds of one kind are not equally crowded. Density is the mean number of "
        "people within 1.5 m of the straight way to the goal, by the free ground there, over the first 20 s. "
        "Lines are 95 % intervals.</p>"
        f'<div class="grid films">{"".join(cards)}</div>'
    )


def _overlays(
    paths: list[dict], episodes: dict[tuple[str, str], dict[int, dict]], scenarios: list[str], navigators: list[str]
) -> str:
    by_cell = {(item["navigator"], item["scenario"]): item["paths"] for item in paths}
    sections = []
    for scenario in scenarios:
        cards = []
        for navigator in navigators:
            rows = list(episodes.get((navigator, scenario), {}).values())
            ways = by_cell.get((navigator, scenario), [])
            count = min(len(rows), len(ways))
            if count:
                outcomes = [row["outcome"] for row in rows[:count]]
                drawing = path_overlay(ways[:count], outcomes)
                cards.append(f'<div class="card"><h3>{escape(navigator)}</h3>{drawing}</div>')
        if cards:
            said = escape(world_in_words(scenario))
            sections.append(
                f'<h3>{escape(scenario)} <span class="muted">{said}</span></h3><div class="grid">{"".join(cards)}</div>'
            )
    if not sections:
        return ""
    return (
        "<h2>The ways they take</h2><p>The first episodes of each cell, turned so that all start at the left and have "
        'their goal (yellow) to the right. <span class="success">Green</span> arrived, '
        '<span class="collision">red</span> ended in a collision at the dot, <span class="timeout">grey</span> ran '
        "out of time.</p>" + "".join(sections)
    )


def _scene_card(scene: dict, index: int) -> str:
    outcome = scene["outcome"]
    return (
        f'<div class="card" data-scene="{index}"><h3>{escape(scene["navigator"])} in {escape(scene["scenario"])}: '
        f'<span class="{outcome}">{outcome}</span></h3><small>{escape(scene["why"])} (seed {scene["seed"]})</small>'
        '<canvas></canvas><p><button>play</button> <input type="range" min="0" value="0" aria-label="time"> '
        '<span class="clock"></span></p></div>'
    )


def _films(scenes: list[dict]) -> str:
    cards = [_scene_card(scene, k) for k, scene in enumerate(scenes) if scene["why"] != "frozen"]
    if not cards:
        return ""
    return (
        "<h2>Best and worst, to be played</h2><p>The robot is blue, people orange, the goal yellow; twice as fast as "
        f'life.</p><div class="grid films">{"".join(cards)}</div>'
    )


def _freezing(scenes: list[dict]) -> str:
    """One episode in which the robot froze, if there is one."""
    for k, scene in enumerate(scenes):
        if scene["why"] == "frozen" or "froze" in scene["why"]:
            return f'<div class="grid films">{_scene_card({**scene, "why": "a robot that freezes"}, k)}</div>'
    return ""


def _differences(episodes: dict[tuple[str, str], dict[int, dict]], navigators: list[str], scenarios: list[str]) -> str:
    main = main_navigator(tuple(navigators))
    rows = []
    for navigator in navigators:
        if navigator == main:
            continue
        shown = []
        for scenario in scenarios:
            ours, theirs = episodes.get((main, scenario)), episodes.get((navigator, scenario))
            if not ours or not theirs:
                shown.append("<td></td>")
                continue
            _, _, d, _ = difference_of(ours, theirs, "success")
            colour = "" if not d.excludes_zero else ' class="success"' if d.mean > 0 else ' class="collision"'
            shown.append(
                f'<td class="num"><span{colour}>{d.mean:+.2f}</span>'
                f'<span class="range">{d.low:+.2f} to {d.high:+.2f}</span></td>'
            )
        rows.append(f"<tr><th>{escape(navigator)}</th>{''.join(shown)}</tr>")
    if not rows:
        return ""
    head = "".join(f"<th>{escape(name).replace(':', ':<br>')}</th>" for name in scenarios)
    return (
        f"<h2>Is it really better?</h2><p>Success of <b>{escape(main)}</b> less that of the others in the very same "
        "worlds, with a paired bootstrap interval (95 %). Coloured where the interval excludes zero, so that chance "
        'alone is no explanation: <span class="success">better</span>, <span class="collision">worse</span>.</p>'
        f"<section><table><tr><th></th>{head}</tr>{''.join(rows)}</table></section>"
    )
