"""Where things fall on a picture, and what is chosen to be shown."""

from __future__ import annotations

import math

import numpy as np
import pytest

from densecavoid.sim.floorplan import FloorPlan
from densecavoid.viz import theme
from densecavoid.viz.scene import Canvas, View, extent_of


def corridor(along_y: bool) -> FloorPlan:
    plan = FloorPlan()
    for side in (-2.0, 2.0):
        plan.wall(*((side, -12.0, side, 12.0) if along_y else (-12.0, side, 12.0, side)))
    return plan


def test_up_on_the_picture_is_y_and_a_metre_is_so_many_pixels():
    view = View((1.0, 2.0), 0, 10.0, 100, 60)
    np.testing.assert_allclose(
        view.pixels(np.array([[1.0, 2.0], [2.0, 2.0], [1.0, 3.0]])), [[50, 30], [60, 30], [50, 20]]
    )


@pytest.mark.parametrize(("turns", "right"), [(0, (1, 0)), (1, (0, 1)), (2, (-1, 0)), (3, (0, -1))])
def test_quarter_turns_keep_left_on_the_left(turns: int, right: tuple[int, int]):
    """What points right stays right, and its left-hand side stays up: turned, never mirrored."""
    view = View((0.0, 0.0), turns, 10.0, 100, 60)
    left_of_right = (-right[1], right[0])
    np.testing.assert_allclose(view.pixels(np.array([right, left_of_right], float)), [[60, 30], [50, 20]], atol=1e-9)


@pytest.mark.parametrize("along_y", [False, True])
@pytest.mark.parametrize("sense", [-1.0, 1.0])
def test_the_way_through_a_corridor_leads_to_the_right(along_y: bool, sense: float):
    way = np.array([[-6.0, 0.3], [6.0, -0.3]]) * sense
    start, goal = way[:, ::-1] if along_y else way
    extent = extent_of(corridor(along_y), start, goal)
    assert extent.elongated
    (x0, _), (x1, _) = extent.view(800, 240).pixels(np.array([start, goal]))
    assert 0 < x0 < 200
    assert 600 < x1 < 800


def test_all_of_a_room_and_both_ends_of_the_way_are_shown():
    plan = FloorPlan()
    plan.room(0.0, 0.0, 10.0, 10.0)
    view = extent_of(plan, np.array([1.0, 1.0]), np.array([9.0, 5.0])).view(400, 400)
    corners = view.pixels(np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]]))
    assert (corners > 0).all() and (corners < 400).all()
    outside = np.array([12.0, 5.0])
    assert (view.pixels(outside) > 400).any()
    assert (extent_of(plan, np.array([1.0, 1.0]), outside).view(400, 400).pixels(outside) < 400).all()


def test_an_open_world_is_shown_around_the_way():
    extent = extent_of(FloorPlan(), np.array([0.0, 0.0]), np.array([3.0, 0.0]))
    assert extent.low_w[0] < -1 and extent.high_w[0] > 4


def test_things_are_drawn_where_they_stand():
    plan = FloorPlan()
    plan.box(2.0, 1.0, 1.0, 1.0, 0.4, z_max=1.0)
    plan.pillar(-2.0, -1.0, 0.5)
    canvas = Canvas(View((0.0, 0.0), 0, 20.0, 200, 120))
    canvas.floor_plan(plan)
    canvas.robot(np.array([0.0, 2.0, 0.0]), 0.3)
    canvas.person(np.array([0.0, -2.0]), None, 0.3)
    image = canvas.image()
    assert image.size == (200, 120)

    def at(x: float, y: float) -> tuple:
        return image.getpixel((round(100 + 20 * x), round(60 - 20 * y)))  # type: ignore[return-value]

    assert at(2.0, 1.0) == theme.FURNITURE
    assert at(-2.0, -1.0) == theme.WALL
    assert at(-0.24, 2.0) == theme.ROBOT
    assert at(0.0, -2.0) == theme.PERSON_EDGE  # the head
    assert at(0.2, -2.0) == at(0.0, -1.8) == theme.PERSON
    assert at(3.5, -2.0) == theme.CARD


@pytest.mark.parametrize("heading", [0.0, math.pi / 2, math.pi, -math.pi / 2])
def test_people_have_shoulders_across_their_way_and_lean_towards_it(heading: float):
    canvas = Canvas(View((0.0, 0.0), 0, 100.0, 100, 100))
    canvas.person(np.zeros(2), heading, 0.3)
    image = canvas.image()

    def at(ahead: float, left: float) -> tuple:
        x = math.cos(heading) * ahead - math.sin(heading) * left
        y = math.sin(heading) * ahead + math.cos(heading) * left
        return image.getpixel((round(50 + 100 * x), round(50 - 100 * y)))  # type: ignore[return-value]

    assert at(0.0, 0.25) == at(0.0, -0.25) == at(-0.1, 0.0) == theme.PERSON
    assert at(0.07, 0.0) == theme.PERSON_EDGE
    assert at(0.25, 0.0) == at(-0.25, 0.0) == at(0.14, 0.27) == theme.CARD
