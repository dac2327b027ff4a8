"""ROS maps: every mode against values worked out by hand from map_server's documented formulas, and walls in place."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from densecavoid.scenarios import make_scenario
from densecavoid.scenarios.free_space import clearances_m
from densecavoid.scenarios.rectangles import cover
from densecavoid.scenarios.ros_map import read_ros_map
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.world import SimConfig, Simulator

KEYS = {
    "image": "map.png",
    "resolution": 0.05,
    "origin": [0.0, 0.0, 0.0],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.196,
}


def write_map(folder: Path, pixels: np.ndarray, image: str = "map.png", **keys: Any) -> Path:
    values = {**KEYS, "image": image, **keys}
    Image.fromarray(pixels).save(folder / image)
    text = "\n".join(f"{key}: {value}" for key, value in values.items() if value is not None)
    (folder / "map.yaml").write_text(text + "\n")
    return folder / "map.yaml"


def cells_of(folder: Path, pixels: list, **keys: Any) -> list[int]:
    """Cell values of a map of one row of pixels."""
    return read_ros_map(write_map(folder, np.array([pixels], np.uint8), **keys)).cells[0].tolist()


# p = (255 - x) / 255: 0 -> 1, 89 -> .651, 90 -> .647, 205 -> .19608, 206 -> .1922, 254 -> .004 (SLAM's white), 255 -> 0


def test_trinary_is_the_default_and_leaves_what_is_between_unknown(tmp_path):
    # 205, what map_saver writes for unknown, is just above .196
    assert cells_of(tmp_path, [0, 89, 90, 128, 205, 206, 254, 255]) == [100, 100, -1, -1, -1, 0, 0, 0]
    assert cells_of(tmp_path, [0, 128, 255], mode="trinary") == [100, -1, 0]


def test_thresholds_themselves_are_neither_occupied_nor_free(tmp_path):
    # p(102) = 153 / 255 = .6 and p(204) = 51 / 255 = .2 to the last bit
    assert cells_of(tmp_path, [101, 102, 204, 205], occupied_thresh=0.6, free_thresh=0.2) == [100, -1, -1, 0]


def test_negate_takes_white_for_occupied(tmp_path):
    assert cells_of(tmp_path, [0, 49, 50, 128, 165, 166, 255], negate=1) == [0, 0, -1, -1, -1, 100, 100]
    assert cells_of(tmp_path, [0, 255], negate="true") == [0, 100]


def test_scale_interpolates_between_the_thresholds(tmp_path):
    # thresholds .2 and .6: p(153) = .4 is half way; p(178) = 77 / 255 = .30196 gives 25.49; p(128) = .49804 gives 74.5
    pixels = [0, 102, 153, 178, 127, 204, 255]
    expected = [100, 100, 50, 25, round((128 / 255 - 0.2) / 0.4 * 100), 0, 0]
    assert cells_of(tmp_path, pixels, mode="scale", occupied_thresh=0.6, free_thresh=0.2) == expected


def test_scale_takes_what_is_not_opaque_for_unknown(tmp_path):
    pixels = [[0, 0, 0, 255], [0, 0, 0, 254], [255, 255, 255, 255], [255, 255, 255, 0], [153, 153, 153, 255]]
    expected = [100, -1, 0, -1, 50]
    assert cells_of(tmp_path, pixels, mode="scale", occupied_thresh=0.6, free_thresh=0.2) == expected


def test_trinary_averages_alpha_with_the_colours(tmp_path):
    # black, opaque: shade (0 + 0 + 0 + 255) / 4 = 63.75, p = .75; white, half clear: (765 + 100) / 4 = 216.25,
    # p = .152; white, clear: 765 / 4 = 191.25, p = .25
    pixels = [[0, 0, 0, 255], [255, 255, 255, 100], [255, 255, 255, 0]]
    assert cells_of(tmp_path, pixels) == [100, 0, -1]


def test_raw_gives_bytes_up_to_100_and_knows_no_thresholds(tmp_path):
    assert cells_of(tmp_path, [0, 1, 50, 99, 100, 101, 255], mode="raw") == [0, 1, 50, 99, 100, -1, -1]
    assert cells_of(tmp_path, [0, 100], mode="raw", negate=1) == [0, 100]


def test_colours_are_averaged(tmp_path):
    # (255 + 0 + 0) / 3 = 85: p = .667; (255 + 255 + 100) / 3 = 203.3: p = .2026
    assert cells_of(tmp_path, [[255, 0, 0], [255, 255, 100], [255, 255, 120]]) == [100, -1, 0]


@pytest.mark.parametrize("form", ["P5", "P2", "png", "bmp", "palette", "16 bit", "1 bit"])
def test_every_image_form_gives_the_same_walls(tmp_path, form):
    pixels = np.full((4, 6), 255, np.uint8)
    pixels[1, 2:5] = 0
    image = {"P5": "m.pgm", "P2": "m.pgm", "bmp": "m.bmp", "16 bit": "m.pgm"}.get(form, "m.png")
    path = write_map(tmp_path, pixels, image)
    if form == "P2":
        body = "\n".join(" ".join(map(str, row)) for row in pixels.tolist())
        (tmp_path / image).write_text(f"P2\n# CREATOR: a map saver 0.050 m/pix\n6 4\n255\n{body}\n")
    elif form == "16 bit":
        (tmp_path / image).write_bytes(b"P5\n6 4\n65535\n" + (pixels.astype(">u2") * 257).tobytes())
    elif form == "palette":
        Image.fromarray(pixels).convert("P").save(tmp_path / image)
    elif form == "1 bit":
        Image.fromarray(pixels).convert("1").save(tmp_path / image)
    occupied = read_ros_map(path).occupied
    assert occupied.sum() == 3
    assert occupied[2, 2:5].all()  # the image's second row from the top of four is the third from below


def test_walls_stand_where_the_origin_and_its_yaw_put_them(tmp_path):
    pixels = np.full((10, 20), 255, np.uint8)
    pixels[9, 4:8] = 0  # the lowest row: columns 4 to 7
    path = write_map(tmp_path, pixels, resolution=0.5, origin=[3.0, -2.0, math.pi / 2])
    ros_map, plan = read_ros_map(path), FloorPlan()
    ros_map.add_walls(plan)
    assert len(plan.boxes) == 1
    x, y, yaw, half_length, half_width, z_min, z_max = plan.boxes[0]
    # In the map's frame the wall spans x from 2 to 4 m and y from 0 to .5; a quarter turn puts (3, .25) at (-.25, 3).
    np.testing.assert_allclose([x, y], [3.0 - 0.25, -2.0 + 3.0])
    np.testing.assert_allclose([yaw, half_length, half_width, z_min, z_max], [math.pi / 2, 1.0, 0.25, 0.0, 2.5])
    assert not ros_map.is_free(np.array([[2.75, 1.0]]))[0]
    assert ros_map.is_free(np.array([[2.75, 5.0], [-1.9, 7.9], [-2.1, 7.9]])).tolist() == [True, True, False]


@given(st.integers(1, 12), st.integers(1, 12), st.integers(0, 2**32))
@settings(max_examples=60, deadline=None)
def test_rectangles_cover_every_marked_cell_once_and_no_other(rows, cols, seed):
    marked = np.random.default_rng(seed).random((rows, cols)) < 0.6
    painted = np.zeros((rows, cols), int)
    for c0, r0, c1, r1 in cover(marked):
        painted[r0:r1, c0:c1] += 1
    np.testing.assert_array_equal(painted, marked.astype(int))


def test_few_rectangles_do_for_walls():
    marked = np.zeros((100, 100), bool)
    marked[:3] = marked[-3:] = marked[:, :3] = marked[:, -3:] = True  # four walls
    marked[40:43, 3:60] = True
    assert len(cover(marked)) == 5
    marked[:, :] = True
    assert len(cover(marked)) == 1


def test_boxes_of_a_turned_map_are_as_far_from_points_as_its_cells(tmp_path):
    rng = np.random.default_rng(5)
    pixels = np.where(rng.random((30, 40)) < 0.1, 0, 255).astype(np.uint8)
    ros_map, plan = read_ros_map(write_map(tmp_path, pixels, resolution=0.2, origin=[1.0, 2.0, 0.4])), FloorPlan()
    ros_map.add_walls(plan)
    points = ros_map.to_world(rng.uniform((0, 0), (40, 30), (50, 2)))
    row, col = np.nonzero(ros_map.occupied)
    for point, clear in zip(points, clearances_m(plan, points), strict=True):
        along, up = ros_map.to_cells(point[None])[0]
        off = np.hypot(np.maximum(np.abs(along - col - 0.5) - 0.5, 0), np.maximum(np.abs(up - row - 0.5) - 0.5, 0))
        assert max(clear, 0.0) == pytest.approx(0.2 * off.min(), abs=1e-5)


def rooms_map(folder: Path, **keys: object) -> Path:
    """12 x 8 m: two rooms with a door of 1 m, unknown outside."""
    pixels = np.full((180, 260), 205, np.uint8)
    pixels[10:170, 10:250] = 254
    pixels[10:12, 10:250] = pixels[168:170, 10:250] = pixels[10:170, 10:12] = pixels[10:170, 248:250] = 0
    pixels[10:170, 128:130] = 0
    pixels[80:100, 128:130] = 254
    return write_map(folder, pixels, "rooms.pgm", **keys)


def test_a_map_becomes_a_scenario_with_people_in_free_cells(tmp_path):
    scenario = make_scenario(f"map:{rooms_map(tmp_path, origin=[-3.0, 1.0, 0.3])}:12")
    ros_map = read_ros_map(tmp_path / "map.yaml")
    simulator = Simulator(scenario, 2, SimConfig(threads=1))
    rooms = set()
    for seed in range(6):
        spec = scenario.spawn(np.random.default_rng(seed))
        again = scenario.spawn(np.random.default_rng(seed))
        assert spec.start_pose == again.start_pose
        np.testing.assert_array_equal(spec.crowd.pos, again.crowd.pos)
        assert spec.crowd.size == 12 and len(spec.floor_plan.boxes) <= 8
        places = np.vstack([spec.crowd.pos, [spec.start_pose[:2]], [spec.goal]])
        assert ros_map.is_free(places).all()
        rooms |= {bool(x > 129) for x in ros_map.to_cells(places)[:, 0]}
        simulator.reset(np.array([seed, seed + 100]))
    assert rooms == {False, True}


def test_nobody_is_put_into_unknown_space(tmp_path):
    pixels = np.full((200, 200), 205, np.uint8)  # 10 x 10 m, unknown
    pixels[100:, :] = 254  # free in the lower half, with no wall between
    scenario = make_scenario(f"map:{write_map(tmp_path, pixels)}:8")
    for seed in range(6):
        spec = scenario.spawn(np.random.default_rng(seed))
        assert spec.crowd.pos[:, 1].max() < 5.0
        assert max(spec.start_pose[1], spec.goal[1], *spec.waypoints[:, 1]) < 5.0


def test_people_default_to_ten_and_may_be_none(tmp_path):
    path = rooms_map(tmp_path)
    assert make_scenario(f"map:{path}").spawn(np.random.default_rng(0)).crowd.size == 10
    assert make_scenario(f"map:{path}:0").spawn(np.random.default_rng(0)).crowd.size == 0
    with pytest.raises(ValueError, match="501 people, expected 0 to 500"):
        make_scenario(f"map:{path}:501")


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"mode": "quaternary"}, r"unknown mode 'quaternary', expected one of: trinary, scale, raw"),
        ({"resolution": 0}, r"resolution is 0\.0, expected metres a pixel, positive"),
        ({"resolution": "wide"}, r"resolution is 'wide', expected a number"),
        ({"resolution": None}, r"resolution is missing"),
        ({"origin": [1.0, 2.0]}, r"origin is \[1\.0, 2\.0\], expected \[x, y, yaw\]"),
        ({"origin": "[1.0, .nan, 0.0]"}, r"origin is .*nan.*finite"),
        ({"negate": "maybe"}, r"negate is 'maybe', expected 0 or 1"),
        ({"free_thresh": 0.7}, r"free_thresh and occupied_thresh is \(0\.7, 0\.65\)"),
        ({"occupied_thresh": 1.5}, r"free_thresh and occupied_thresh"),
    ],
)
def test_a_wrong_map_yaml_is_refused_by_file_and_key(tmp_path, keys, message):
    path = write_map(tmp_path, np.zeros((2, 2), np.uint8), **keys)
    with pytest.raises(ValueError, match=r"map\.yaml: .*" + message):
        read_ros_map(path)


def test_wrong_files_are_refused(tmp_path):
    path = write_map(tmp_path, np.zeros((2, 2), np.uint8))
    (tmp_path / "map.png").write_bytes(b"not an image")
    with pytest.raises(ValueError, match=r"image .*map\.png' cannot be read"):
        read_ros_map(path)
    (tmp_path / "map.png").unlink()
    with pytest.raises(ValueError, match="does not exist"):
        read_ros_map(path)
    path.write_text("image: [unclosed\n")
    with pytest.raises(ValueError, match="is no YAML"):
        read_ros_map(path)
    path.write_text("just words\n")
    with pytest.raises(ValueError, match="expected keys image"):
        read_ros_map(path)
    with pytest.raises(ValueError, match=r"no file .*nowhere\.yaml"):
        make_scenario("map:nowhere.yaml")
    with pytest.raises(ValueError, match=r"expected map:FILE\[:PEOPLE\]"):
        make_scenario("map:")


def test_a_map_without_room_is_refused(tmp_path):
    full = write_map(tmp_path, np.zeros((50, 50), np.uint8))
    with pytest.raises(ValueError, match="no free cell"):
        make_scenario(f"map:{full}")
    tight = np.zeros((100, 100), np.uint8)
    tight[:, 48:54] = 255  # .3 m wide
    path = write_map(tmp_path, tight, free_thresh=0.19)
    with pytest.raises(ValueError, match="no free space"):
        make_scenario(f"map:{path}").spawn(np.random.default_rng(0))


@pytest.mark.slow
def test_a_map_of_16_million_pixels_is_read_in_seconds(tmp_path):
    size = 4000
    pixels = np.full((size, size), 254, np.uint8)
    for k in range(0, size, 200):
        pixels[k : k + 4] = pixels[:, k : k + 4] = 0
    for k in range(100, size, 200):  # doors
        for wall in range(0, size, 200):
            pixels[k - 12 : k + 12, wall : wall + 4] = pixels[wall : wall + 4, k - 12 : k + 12] = 254
    pixels[np.random.default_rng(0).random(pixels.shape) < 3e-4] = 0
    cover(np.ones((2, 2), bool))  # compiles
    path = write_map(tmp_path, pixels, "big.pgm")
    begin = time.perf_counter()
    scenario = make_scenario(f"map:{path}:20")
    assert time.perf_counter() - begin < 3.0
    spec = scenario.spawn(np.random.default_rng(0))
    assert spec.crowd.size == 20
    assert 20 < len(spec.floor_plan.boxes) < 3000  # what is far away is left out of the world
