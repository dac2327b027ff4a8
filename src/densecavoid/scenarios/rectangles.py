"""Covers the marked cells of a grid with few rectangles that do not overlap."""

from __future__ import annotations

import numpy as np

from densecavoid.sim._jit import inner, kernel


@inner
def _run(left, row, col, d_row, d_col, most):
    """How many cells from (row, col) on are still to cover, at most so many."""
    count = 0
    while count < most and row < left.shape[0] and col < left.shape[1] and left[row, col]:
        count += 1
        row += d_row
        col += d_col
    return count


@inner
def _grow(left, row, col, d_row, d_col):
    """Length and breadth of the rectangle that grows from a cell along (d_row, d_col) first, then across."""
    length, breadth = _run(left, row, col, d_row, d_col, left.size), 1
    while _run(left, row + breadth * d_col, col + breadth * d_row, d_row, d_col, length) == length:
        breadth += 1
    return length, breadth


@kernel
def _cover(left, out):
    count = 0
    for row in range(left.shape[0]):
        for col in range(left.shape[1]):
            if not left[row, col]:
                continue
            height, width = _grow(left, row, col, 1, 0)
            other_width, other_height = _grow(left, row, col, 0, 1)
            if other_height * other_width > height * width:
                height, width = other_height, other_width
            for r in range(row, row + height):
                for c in range(col, col + width):
                    left[r, c] = False
            if count < out.shape[0]:
                out[count, 0], out[count, 1] = col, row
                out[count, 2], out[count, 3] = col + width, row + height
            count += 1
    return count


def cover(marked):
    """Rectangles [N, 4] as (first column, first row, end column, end row) that cover the marked cells [rows, cols].

    Greedy: from each cell that is left, in order, the larger of the rectangle that grows along the row first and the
    one that grows along the column first.
    """
    out = np.zeros((1024, 4), np.int64)
    count = _cover(np.array(marked, np.bool_, order="C"), out)
    if count > len(out):
        out = np.zeros((count, 4), np.int64)
        _cover(np.array(marked, np.bool_, order="C"), out)
    return out[:count]
