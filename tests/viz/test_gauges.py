"""Commands as bars: the right way round, and as long as they are large."""

from __future__ import annotations

import math

import numpy as np
import pytest
from PIL import Image

from densecavoid.viz import theme
from densecavoid.viz.gauges import Gauge, Velocity


def columns(page: Image.Image, colour: theme.Colour) -> np.ndarray:
    """Those of the bar (18 pixels below the top, 10 high) that have the colour."""
    return np.flatnonzero(np.abs(np.asarray(page)[22].astype(int) - colour).sum(axis=-1) < 60)


def test_a_turn_to_the_left_goes_left_and_what_was_asked_is_marked() -> None:
    page = Image.new("RGB", (200, 100), theme.CARD)
    Gauge("turn", "rad/s", 0.4, -0.4, 50).draw(page, (0, 0, 200, 100), Velocity(asked=0.4, given=0.2))
    filled = columns(page, theme.ROBOT)
    assert filled.min() == pytest.approx(50, abs=2) and filled.max() == pytest.approx(99, abs=2)
    assert columns(page, theme.INK).max() < 3
    Gauge("forward", "m/s", 0.0, 1.0, 50).draw(page, (0, 0, 200, 100), Velocity(math.nan, 0.25))
    filled = columns(page, theme.ROBOT)
    assert filled.min() < 4 and filled.max() == pytest.approx(49, abs=2)
