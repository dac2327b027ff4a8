"""The picture of what sensors show: drawn for a world with people, every panel different and not empty."""

from __future__ import annotations

import numpy as np
from PIL import Image

from densecavoid.scenarios import make_scenario
from densecavoid.viz.sensors import main, sensor_sheet


def test_every_panel_shows_something_of_its_own():
    sheet = np.asarray(sensor_sheet(make_scenario("dense-ped")).convert("RGB"))
    panels = [
        sheet[28 + 342 * row : 340 + 342 * row, 14 + 414 * col : 414 + 414 * col] for row in (0, 1) for col in range(3)
    ]
    for k, panel in enumerate(panels):
        assert len(np.unique(panel.reshape(-1, 3), axis=0)) > 10
        assert all(np.abs(panel.astype(int) - other).mean() > 5 for other in panels[:k])


def test_the_command_writes_a_picture(tmp_path):
    main([str(tmp_path / "sensors.png"), "random-sparse-ped"])
    with Image.open(tmp_path / "sensors.png") as picture:
        assert picture.size[0] > 1000
