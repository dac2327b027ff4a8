"""The page that films are laid out on: boxes, cards, labels and figures, in pixels. Knows no worlds and no sensors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from densecavoid.frames import CameraConfig
from densecavoid.viz import theme

Box = tuple[int, int, int, int]
"""Left, top, width and height in pixels."""
GAP, TITLE, LABEL, PAD = 12, 46, 24, 8
"""Between cards, of the line above them, of the line in a card, inside a card."""
_SUPERSAMPLING = 3
_MIDDLE = TITLE // 2 + 1
"""Of the title's line."""


def inset(box: Box, pad: int, above: int) -> Box:
    """What is left of a card inside its padding and under its label."""
    left, top, width, height = box
    return left + pad, top + above, width - 2 * pad, height - above - pad


def fitted(box: Box, aspect: float) -> Box:
    """The largest centred box of an aspect inside another."""
    left, top, width, height = box
    fitted_width = min(width, round(height * aspect))
    fitted_height = round(fitted_width / aspect)
    return left + (width - fitted_width) // 2, top + (height - fitted_height) // 2, fitted_width, fitted_height


def blank_page(size_px: tuple[int, int], cards: Sequence[Box]) -> Image.Image:
    """A page with rounded cards on it."""
    times = _SUPERSAMPLING
    enlarged = Image.new("RGB", (size_px[0] * times, size_px[1] * times), theme.PAGE)
    draw = ImageDraw.Draw(enlarged)
    for left, top, width, height in cards:
        box = [times * side for side in (left, top, left + width, top + height)]
        draw.rounded_rectangle(box, 8 * times, fill=theme.CARD, outline=theme.BORDER, width=times)
    return enlarged.reduce(times)


def title(page: Image.Image, name: str, where: str) -> None:
    """Who drives, and where."""
    draw = ImageDraw.Draw(page)
    draw.text((GAP + 2, _MIDDLE), name, theme.INK, theme.font(19), anchor="lm")
    end = GAP + 2 + draw.textlength(name, theme.font(19))
    draw.text((end + 9, _MIDDLE + 1), where, theme.MUTED, theme.font(16), anchor="lm")


def label(page: Image.Image, card: Box, name: str, note: str = "") -> None:
    """A card's name, and at its right a note."""
    left, top, width, _ = card
    draw, line = ImageDraw.Draw(page), top + LABEL // 2 + 1
    draw.text((left + PAD + 1, line), name, theme.INK, theme.font(13), anchor="lm")
    draw.text((left + width - PAD - 1, line), note, theme.MUTED, theme.font(12), anchor="rm")


def figure(page: Image.Image, right: int, text: str) -> None:
    """A figure in the title's line, right-aligned."""
    ImageDraw.Draw(page).text((right, _MIDDLE), text, theme.INK, theme.font(16), anchor="rm")


def depth_scale(page: Image.Image, card: Box, camera: CameraConfig) -> None:
    """The colours of depth from near to far, with their ends, in the line of a card's label."""
    right, middle = card[0] + card[2] - PAD - 1, card[1] + LABEL // 2 + 1
    draw = ImageDraw.Draw(page)
    near, far = f"{camera.min_range_m:g}", f"{camera.max_range_m:g} m"
    draw.text((right, middle), far, theme.MUTED, theme.font(12), anchor="rm")
    bar_right = round(right - draw.textlength(far, theme.font(12))) - 5
    bar = Image.fromarray(np.repeat(theme.depth_colours(np.linspace(1, 0, 48))[None], 7, axis=0))
    page.paste(bar, (bar_right - bar.width, middle - 3))
    draw.text((bar_right - bar.width - 5, middle), near, theme.MUTED, theme.font(12), anchor="rm")


def pill(page: Image.Image, right: int, text: str, colour: theme.Colour) -> None:
    """A rounded label in the title's line, right-aligned."""
    width, height, times = round(theme.font(14).getlength(text)) + 24, 26, 4
    rounded = Image.new("RGB", (width * times, height * times), theme.PAGE)
    corner = (0, 0, width * times - 1, height * times - 1)
    ImageDraw.Draw(rounded).rounded_rectangle(corner, height * times // 2, fill=colour)
    page.paste(rounded.reduce(times), (right - width, _MIDDLE - height // 2))
    ImageDraw.Draw(page).text((right - width / 2, _MIDDLE), text, theme.CARD, theme.font(14), anchor="mm")
