"""The sheet of detections: what is drawn where."""

from __future__ import annotations

import numpy as np

from densecavoid.frames import CameraConfig
from densecavoid.perception.detector.detector import DepthDetector
from densecavoid.perception.detector.views import ViewsConfig, take_views
from densecavoid.perception.detector.worlds import held_out_worlds
from densecavoid.perception.evaluation.detector import look_at
from densecavoid.viz.detections import detection_sheet, main


def test_found_boxes_are_drawn_at_their_edges_in_the_images_place():
    camera = CameraConfig()
    views = take_views(held_out_worlds(), 30, 2, ViewsConfig(vary_mount=False))
    views = views.rows(np.argsort(-views.num_people, kind="stable")[:3])
    found = look_at(views, DepthDetector())
    n = int(np.argmax([len(f.boxes.box) for f in found]))
    box = found[n].boxes.box[-1]  # drawn last
    page = np.asarray(detection_sheet(views, found, camera, columns=2)).astype(int)
    assert page.shape == (28 + 8 + 2 * (240 + 8), 8 + 2 * (320 + 8), 3)
    left, top = 8 + (n % 2) * 328, 36 + (n // 2) * 248
    middle = top + int(2 * (box[1] + box[3]))
    edge = page[middle, left + round(4 * float(box[0]))]
    assert np.abs(edge - (214, 51, 108)).max() < 10


def test_the_command_writes_the_sheet(tmp_path, capsys):
    main(["--out", str(tmp_path / "sheet.png"), "--columns", "1", "--rows", "1"])
    assert (tmp_path / "sheet.png").stat().st_size > 1000
    assert "sheet.png" in capsys.readouterr().out
