"""Compiles what sensors and perception need, and keeps it: the second process of a first start (sim/_jit.py)."""

from __future__ import annotations

from densecavoid.env.observation import Observer, ObserverConfig
from densecavoid.scenarios import make_scenario
from densecavoid.sim.world import SimConfig, Simulator


def main() -> None:
    """One look at one world that nobody has filled: kernels depend on the kinds of their arguments alone."""
    all_there_is = ObserverConfig(
        people_from="detector", remembers=True, foretold_s=(1.0,), route_every_s=1.0, weighs_commands=True, threads=1
    )
    Observer(all_there_is, 1).observe(Simulator(make_scenario("random-goal"), 1, SimConfig(threads=1)).sense())


if __name__ == "__main__":
    main()
