"""A policy as the demo, the benchmark and the robot run it: an ONNX file in ONNX Runtime. No torch, no sensors."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32

from densecavoid.frames import COMMAND_GRID, Observation
from densecavoid.networks.onnx_files import Shelf
from densecavoid.policy.card import PolicyCard

_TYPES = {
    "lidar": ("tensor(float)", np.float32),
    "camera": ("tensor(uint8)", np.uint8),
    "goal": ("tensor(float)", np.float32),
    "velocity": ("tensor(float)", np.float32),
    "prediction": ("tensor(uint8)", np.uint8),
    "worth": ("tensor(float)", np.float32),
}
_NEED_NOT_SEE = "worth"


POLICIES = Shelf("policy", "densecavoid.policy")
"""Those that come with the package."""


class OnnxPolicy:
    """Observation -> command. Stateless between calls."""

    def __init__(self, name_or_path: str | Path, threads: int = 1) -> None:
        """Loads and checks the file.

        Args:
            name_or_path: a shipped policy's name or an ONNX file.
            threads: of one call. One is fastest for small batches and leaves the other cores alone.

        Raises:
            FileNotFoundError: if there is no such policy.
            ValueError: if the file is not a policy of this project.
        """
        opened = POLICIES.open(name_or_path, threads)
        self._session, self.sha256 = opened.session, opened.sha256
        self.card = PolicyCard.from_metadata(opened.metadata, f"the file of policy {str(name_or_path)!r}")
        self._shapes = self._check_graph(str(name_or_path))
        self._grid = COMMAND_GRID * [self.card.max_linear_velocity, self.card.max_angular_velocity]

    def __call__(
        self, observation: Observation, noise: Float[np.ndarray, "B 2"] | None = None
    ) -> Float32[np.ndarray, "B 2"]:
        """The likeliest command (v m/s, w rad/s) for each row; or, with standard normal `noise`, the draw that it makes
        (as in `distribution`).

        Raises:
            ValueError: naming the array whose shape does not fit.
        """
        feed = {}
        batch = observation.lidar.shape[0]
        for name, shape in self._shapes.items():
            array, expected = getattr(observation, name), (batch, *shape)
            if array.shape != expected:
                raise ValueError(
                    f"observation.{name} has shape {array.shape}, expected {expected} for {self.card.name!r}"
                )
            feed[name] = np.ascontiguousarray(array, dtype=_TYPES[name][1])
        if noise is None:
            return np.asarray(self._session.run(["mean"], feed)[0])
        if self.card.log_std is None:
            below = np.exp(np.asarray(self._session.run(["log_probs"], feed)[0], np.float64)).cumsum(axis=1)
            quantile = np.array([0.5 * math.erfc(-x / math.sqrt(2.0)) for x in noise[:, 0]])
            chosen = (below <= np.minimum(quantile, np.nextafter(1.0, 0.0))[:, None] * below[:, -1:]).sum(axis=1)
            return self._grid[chosen].astype(np.float32)
        return np.asarray(self._session.run(["mean"], feed)[0] + np.exp(self.card.log_std) * noise, np.float32)

    def _check_graph(self, source: str) -> dict[str, tuple[int, ...]]:
        inputs = {node.name: node for node in self._session.get_inputs()}
        if set(inputs) | {_NEED_NOT_SEE} != set(_TYPES):
            raise ValueError(f"{source} has the inputs {sorted(inputs)}, expected {sorted(_TYPES)}")
        for name, node in inputs.items():
            kind, shape = _TYPES[name][0], node.shape
            if node.type != kind:
                raise ValueError(f"{source}: input {name} is a {node.type}, expected a {kind}")
            if len(shape) == 0:
                raise ValueError(f"{source}: input {name} is a single number, expected rows of them")
            if not isinstance(shape[0], str):
                raise ValueError(f"{source}: input {name} has the fixed batch size {shape[0]}, expected any")
        outputs = [node.name for node in self._session.get_outputs()]
        expected = ["mean", "log_probs"] if self.card.chooses else ["mean"]
        if outputs != expected:
            raise ValueError(f"{source} has the outputs {outputs}, expected {expected}")
        return {name: tuple(node.shape[1:]) for name, node in inputs.items()}
