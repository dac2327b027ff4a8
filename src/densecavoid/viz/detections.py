"""A sheet of depth images with true boxes and found ones: `python -m densecavoid.viz.detections OUT.png`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from PIL import Image, ImageDraw

from densecavoid.frames import CameraConfig, require
from densecavoid.perception.detector.detector import DepthDetector
from densecavoid.perception.detector.views import Views, ViewsConfig, take_views
from densecavoid.perception.detector.worlds import held_out_worlds
from densecavoid.perception.evaluation.detector import Found, look_at, to_find
from densecavoid.perception.truth_detector import MIN_VISIBLE_FRACTION
from densecavoid.viz import theme
from densecavoid.viz.panels import depth_picture

_PIXEL, _GAP, _LEGEND_PX = 4, 8, 28
_TRUE, _HIDDEN, _FOUND = theme.OUTCOME["success"], theme.MUTED, theme.LIDAR


@dataclass(frozen=True)
class SheetConfig:
    """Settings of the sheet."""

    out: Path
    """Where the picture goes."""
    detector: str = "depth-yolo"
    """A shipped detector's name, or an ONNX file."""
    columns: int = 5
    rows: int = 4
    seed: int = 7
    """Decides the worlds."""
    least_people: int = 2
    """In each image."""

    def __post_init__(self) -> None:
        for name in ("columns", "rows"):
            require(getattr(self, name) >= 1, f"SheetConfig.{name}", getattr(self, name), "at least 1")


def detection_sheet(views: Views, found: Sequence[Found], camera: CameraConfig, columns: int) -> Image.Image:
    """All images in a grid: people to find in green, those of whom less than a third is seen in grey, found in red."""
    width, height = camera.width * _PIXEL, camera.height * _PIXEL
    rows = -(-len(found) // columns)
    size = columns * (width + _GAP) + _GAP, rows * (height + _GAP) + _GAP + _LEGEND_PX
    page = Image.new("RGB", size, theme.PAGE)
    draw = ImageDraw.Draw(page)
    for k, (text, colour) in enumerate(
        (("person to find", _TRUE), ("less than a third seen", _HIDDEN), ("found, with confidence", _FOUND))
    ):
        draw.text((_GAP + 230 * k, 6), text, colour, theme.font(16))
    wanted = to_find(views, (0.0, np.inf), (MIN_VISIBLE_FRACTION, np.inf))
    for n, (depth, (boxes, _)) in enumerate(zip(views.depth_m, found, strict=True)):
        left = _GAP + (n % columns) * (width + _GAP)
        top = _LEGEND_PX + _GAP + (n // columns) * (height + _GAP)
        picture = depth_picture(depth, camera, (width, height))
        pen = ImageDraw.Draw(picture)
        for j in range(views.num_people[n]):
            pen.rectangle(_pixels(views.box[n, j]), outline=_TRUE if wanted[n, j] else _HIDDEN, width=2)
        for box, confidence in zip(boxes.box, boxes.confidence, strict=True):
            corners = _pixels(box)
            pen.rectangle(corners, outline=_FOUND, width=2)
            pen.text((corners[0] + 4, corners[1] + 2), f"{confidence:.2f}", _FOUND, theme.font(12))
        page.paste(picture, (left, top))
    return page


def _pixels(box: np.ndarray) -> tuple[float, float, float, float]:
    u_min, v_min, u_max, v_max = (_PIXEL * box).tolist()
    return u_min, v_min, u_max - 1, v_max - 1


def main(args: Sequence[str] | None = None) -> None:
    """Draws the sheet."""
    config = tyro.cli(SheetConfig, prog="python -m densecavoid.viz.detections", args=args)
    write_sheet(config)
    print(config.out)


def write_sheet(config: SheetConfig) -> None:
    """Takes images in held-out worlds, looks at them, and writes the sheet."""
    detector = DepthDetector(config.detector)
    wanted = config.columns * config.rows
    views = take_views(held_out_worlds(), 8 * wanted, config.seed, ViewsConfig(detector.camera, vary_mount=False))
    views = views.rows(np.flatnonzero(views.num_people >= config.least_people)[:wanted])
    detection_sheet(views, look_at(views, detector), detector.camera, config.columns).save(config.out)


if __name__ == "__main__":
    main()
