"""Left and right exchanged: whatever happened to a robot could have happened the other way round. A sample seen in the
mirror is another sample that costs no simulation.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from densecavoid.frames import COMMAND_GRID
from densecavoid.policy.network import ObservationTensors

_LEFT_IS_NEGATIVE = {"goal": 1, "velocity": 1}
"""Which number of these changes its sign: bearing, angular velocity."""
_PEOPLE_ACROSS = (1, 3)
"""y and velocity along y."""
_TURNED_COMMANDS = [COMMAND_GRID.tolist().index([v, -w]) for v, w in COMMAND_GRID]
"""Which command of the grid each becomes."""


def mirror_observation(observation: ObservationTensors, which: Bool[Tensor, "B"]) -> ObservationTensors:
    """The observation with the marked samples seen in the mirror. Sensors look straight ahead from the middle."""
    changed = {}
    for name, x in observation._asdict().items():
        if name == "worth":
            changed[name] = torch.where(which[:, None], x[:, _TURNED_COMMANDS], x)
        elif name in _LEFT_IS_NEGATIVE:
            changed[name] = _negated(x, (_LEFT_IS_NEGATIVE[name],), which[:, None])
        else:
            changed[name] = x.clone()
            changed[name][which] = x[which].flip(-1)
    return ObservationTensors(**changed)


def mirror_people(people: Float[Tensor, "B K numbers"], which: Bool[Tensor, "B"]) -> Float[Tensor, "B K numbers"]:
    """The same of what a privileged critic is told."""
    return _negated(people, _PEOPLE_ACROSS, which[:, None, None])


def mirror_action(action: Float[Tensor, "B 2"], which: Bool[Tensor, "B"]) -> Float[Tensor, "B 2"]:
    """The same of (v, w)."""
    return _negated(action, (1,), which[:, None])


def _negated(x: Tensor, places: tuple[int, ...], which: Tensor) -> Tensor:
    sign = torch.ones(x.shape[-1], dtype=x.dtype, device=x.device)
    sign[list(places)] = -1
    return torch.where(which, x * sign, x)
