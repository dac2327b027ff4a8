"""What is asked of the wheels and what they get, as bars and as the last seconds' course. Knows numbers, not robots."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

from PIL import Image, ImageDraw

from densecavoid.viz import theme
from densecavoid.viz.page import Box

_TIMES = 3
"""Drawn so many times larger and then averaged."""
_TEXT_PX, _BAR_PX, _GAP_PX = 18, 10, 6


class Velocity(NamedTuple):
    """At one instant."""

    asked: float
    """By the policy."""
    given: float
    """To the wheels."""


class Gauge:
    """One velocity: a bar that says what the wheels get, a mark on it for what was asked, and below both over time."""

    def __init__(self, name: str, unit: str, left: float, right: float, keep: int) -> None:
        """
        Args:
            name, unit: for the text.
            left, right: values at the bar's ends; the bar begins at 0. Over time, more is up.
            keep: instants that the course shows, of equal distance.
        """
        self._name, self._unit, self._left, self._right = name, unit, left, right
        self._keep = keep
        self._course: deque[Velocity] = deque(maxlen=keep)

    def draw(self, page: Image.Image, box: Box, now: Velocity) -> None:
        """Takes in the next instant, and paints the gauge into a box of the page."""
        self._course.append(now)
        left, top, width, height = box
        bars = Image.new("RGB", (width * _TIMES, (height - _TEXT_PX) * _TIMES), theme.CARD)
        self._bar(ImageDraw.Draw(bars), bars.width, now)
        self._lines(ImageDraw.Draw(bars), bars.width, bars.height)
        page.paste(bars.reduce(_TIMES), (left, top + _TEXT_PX))
        draw, middle = ImageDraw.Draw(page), top + _TEXT_PX // 2 - 1
        draw.text((left, middle), self._name, theme.INK, theme.font(13), anchor="lm")
        asked = f"asked {now.asked:.2f}"
        draw.text((left + width, middle), f"{now.given:.2f} {self._unit}", theme.ROBOT, theme.font(13), anchor="rm")
        draw.text((left + width - 82, middle), asked, theme.MUTED, theme.font(12), anchor="rm")

    def _share(self, value: float) -> float:
        """Where on the bar a value lies, from the left, in [0, 1]; what is not finite lies where 0 does."""
        value = value if math.isfinite(value) else 0.0
        return min(max((value - self._left) / (self._right - self._left), 0.0), 1.0)

    def _height(self, value: float) -> float:
        """How far up it lies, in [0, 1]."""
        return self._share(value) if self._right > self._left else 1.0 - self._share(value)

    def _bar(self, draw: ImageDraw.ImageDraw, width: int, now: Velocity) -> None:
        bottom, last = _BAR_PX * _TIMES - 1, width - 1
        draw.rectangle((0, 0, last, bottom), fill=theme.GRID)
        ends = sorted((self._share(0.0) * last, self._share(now.given) * last))
        draw.rectangle((ends[0], 0, ends[1], bottom), fill=theme.ROBOT)
        zero, mark = self._share(0.0) * last, self._share(now.asked) * last
        draw.rectangle((zero - 1, 0, zero + 1, bottom), fill=theme.MUTED)
        draw.rectangle((mark - _TIMES, 0, mark + _TIMES, bottom), fill=theme.INK)

    def _lines(self, draw: ImageDraw.ImageDraw, width: int, height: int) -> None:
        top, last = (_BAR_PX + _GAP_PX) * _TIMES, height - 1
        draw.rectangle((0, top, width - 1, last), fill=theme.GRID)
        inner = last - top - 4 * _TIMES

        def line(values: Iterable[float], colour: theme.Colour, width_px: float) -> None:
            values = list(values)
            first = self._keep - len(values)
            points = [
                ((first + k) / max(self._keep - 1, 1) * (width - 1), last - 2 * _TIMES - self._height(value) * inner)
                for k, value in enumerate(values)
            ]
            if len(points) > 1:
                draw.line(points, fill=colour, width=round(width_px * _TIMES), joint="curve")

        line([0.0] * self._keep, theme.BORDER, 1.0)
        line((one.asked for one in self._course), theme.MUTED, 1.0)
        line((one.given for one in self._course), theme.ROBOT, 1.7)
