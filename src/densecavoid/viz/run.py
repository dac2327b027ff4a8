"""The first thing a newcomer does: one robot, one crowd, one episode, to be looked at and read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from densecavoid.benchmark.episode_file import write_episode
from densecavoid.benchmark.metrics import EpisodeMetrics, episode_metrics
from densecavoid.benchmark.navigators import make_navigator
from densecavoid.frames import require
from densecavoid.scenarios import make_scenario
from densecavoid.sim.config import Attitudes, Motion, Pace
from densecavoid.sim.world import SimConfig, Simulator
from densecavoid.viz.film import film_episode
from densecavoid.viz.pictures import save_episode_picture


@dataclass(frozen=True)
class RunConfig:
    """Settings of `densecavoid run`."""

    scenario: str = "dense-ped"
    """A scenario by name, `hermes:<run>[:reactive]`, `tracks:FILE[:reactive]`, `map:FILE[:PEOPLE]` or `plan:FILE`."""
    navigator: str = "densecavoid"
    """A navigator by name, or the path of an exported policy (.onnx)."""
    seed: int = 0
    """Which of the scenario's worlds."""
    out: Path = Path("runs/demo")
    """Folder for the film, episode.json and episode.png."""
    data: Path | None = None
    """Folder of the recordings, for `hermes` scenarios; else the environment variable DENSECAVOID_DATA."""
    film: Literal["gif", "mp4"] = "gif"
    """Kind of film."""
    people: Attitudes = "scripted"
    """Whether people make way for the robot; mixed: some do, some do not, some stand in its way."""
    pace: Pace = "scenario"
    """Whether people walk at the scenario's speeds, or everyone briskly, or in a rush."""
    motion: Motion = "anticipation"
    """How people make their way."""
    dynamics: Literal["ideal", "dynamic"] = "ideal"
    """Whether commands take effect at once, or with the base's limits and delay."""
    sensors: Literal["clean", "real"] = "clean"
    """Whether sensors are exact, or have noise, gaps and drifting odometry."""

    def __post_init__(self) -> None:
        require(self.seed >= 0, "RunConfig.seed", self.seed, "0 or more")

    @property
    def film_path(self) -> Path:
        return self.out / f"episode.{self.film}"


def run(config: RunConfig) -> EpisodeMetrics:
    """Runs and films one episode; writes `episode.gif` (or .mp4), `episode.json` and `episode.png` into `config.out`.

    Raises:
        ValueError: for an unknown scenario or navigator, or a malformed recording.
        OSError: if a file cannot be read or written.
    """
    sim_config = SimConfig(
        people=config.people,
        pace=config.pace,
        motion=config.motion,
        dynamics=config.dynamics,
        sensors=config.sensors,
    )
    navigator = make_navigator(config.navigator, sim_config.robot)
    simulator = Simulator(make_scenario(config.scenario, config.data), 1, sim_config)
    config.out.mkdir(parents=True, exist_ok=True)
    episode = film_episode(simulator, navigator, config.seed, config.film_path)
    write_episode(config.out / "episode.json", episode)
    save_episode_picture(config.out / "episode.png", episode)
    return episode_metrics(episode)


def one_line(metrics: EpisodeMetrics) -> str:
    """The result in a line."""
    frozen = ", frozen for a while" if metrics.frozen else ""
    nearest = "" if metrics.clearance_people_m is None else f", nearest person {metrics.clearance_people_m:.2f} m"
    return f"{metrics.outcome}{frozen} after {metrics.duration_s:.1f} s and {metrics.path_length_m:.1f} m{nearest}"
