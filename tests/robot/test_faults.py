"""The fault campaign: no over-limit command, no missed stop, nothing hung; a short one here, a long one by command."""

from __future__ import annotations

import pytest

from densecavoid.robot.faults import KINDS, Campaign, FaultsConfig, run_faults, table


def check(number: int, seed: int) -> None:
    rows = run_faults(FaultsConfig(number, seed))
    print(table(rows))
    assert sum(row.injected for row in rows) == number
    for row in rows:
        name = f"{row.kind.name} {row.kind.target}"
        assert row.over_limit == row.missed == row.hung == row.unexplained == 0, f"{name}: {row}"


def test_a_short_campaign() -> None:
    check(4 * len(KINDS), seed=1)


@pytest.mark.slow
def test_a_longer_campaign() -> None:
    check(1000, seed=2)


def test_the_campaign_can_fail() -> None:
    """A watchdog that never bites lets the robot drive on blindly, and the table says so."""
    campaign = Campaign(3)
    assert campaign.drive(5.0)
    campaign.runtime.watchdog.sensors_fault = lambda now_s: ""  # type: ignore[method-assign]
    campaign.runtime.filter._missing = lambda now_s: ""  # type: ignore[method-assign]
    kinds = [kind for kind in KINDS if kind.name == "drop"]
    for kind in kinds * 8:
        campaign.inject(kind)
    assert sum(row.missed for row in campaign.rows.values()) > 5
