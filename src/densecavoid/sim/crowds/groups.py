"""How people who belong together walk: abreast, at a common speed, and waiting for one another.

A plain form of the group terms of Moussaid et al. (PLoS ONE 2010): instead of gaze and cohesion forces, each member
corrects their way towards a place of their own in a line abreast through the group's centre, in the order in which they
are walking, so that nobody has to cross over. Everybody goes to where the first of them goes.
"""

from __future__ import annotations

import math

from densecavoid.sim._jit import inner
from densecavoid.sim.crowds.neighbours import walks

_SPACING_M = 0.7  # between neighbours of a line abreast (Moussaid et al. 2010: .75 m on average)
_CATCH_UP_S = 1.0  # in which a member makes up for what is missing to their place
_MOST = 0.5  # of the preferred speed that this may take or add
_LOST_M = 6.0  # who is farther from the group's centre than this walks alone


@inner
def walk_together(state, b, scratch):
    """Corrects what the members of groups in world b want, so that they stay together."""
    num_people = state.pos.shape[1]
    # Linked lists: the first of each group, the next of each member.
    first, following = scratch.cell_start, scratch.near
    first[:num_people] = -1
    groups = 0
    for i in range(num_people - 1, -1, -1):
        group = state.group[b, i]
        if group >= 0 and walks(state.behaviour[b, i]):
            following[i], first[group] = first[group], i
            groups = max(groups, group + 1)
    for group in range(groups):
        leader, count, centre_x, centre_y = first[group], 0, 0.0, 0.0
        i = leader
        while i >= 0:
            centre_x, centre_y, count = centre_x + state.pos[b, i, 0], centre_y + state.pos[b, i, 1], count + 1
            i = following[i]
        if count < 2:
            continue
        centre_x, centre_y = centre_x / count, centre_y / count
        way_x, way_y = scratch.intended[leader, 0], scratch.intended[leader, 1]
        speed = math.sqrt(way_x * way_x + way_y * way_y)
        if speed < 1e-6:
            continue
        way_x, way_y = way_x / speed, way_y / speed
        i = leader
        while i >= 0:
            off_x, off_y = state.pos[b, i, 0] - centre_x, state.pos[b, i, 1] - centre_y
            ahead, aside = off_x * way_x + off_y * way_y, off_y * way_x - off_x * way_y
            if off_x * off_x + off_y * off_y < _LOST_M * _LOST_M:
                for axis in range(2):
                    state.person_goal[b, i, axis] = state.person_goal[b, leader, axis]
                rank, j = 0, leader  # members to the right
                while j >= 0:
                    other = (state.pos[b, j, 1] - centre_y) * way_x - (state.pos[b, j, 0] - centre_x) * way_y
                    if other < aside or (other == aside and j < i):
                        rank += 1
                    j = following[j]
                most = _MOST * speed
                along = min(max(-ahead / _CATCH_UP_S, -most), most)
                across = ((rank - 0.5 * (count - 1)) * _SPACING_M - aside) / _CATCH_UP_S
                across = min(max(across, -most), most)
                scratch.intended[i, 0] = (speed + along) * way_x - across * way_y
                scratch.intended[i, 1] = (speed + along) * way_y + across * way_x
            i = following[i]
