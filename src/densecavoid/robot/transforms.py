"""The tree of coordinate frames (TF) as far as a robot on a floor needs it: poses in the plane, and heights; whole
rotations for cameras. No tf2.

Edges that move keep their last pose only; how old it is decides whether it may be used. Static ones do not age.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from densecavoid.frames import require
from densecavoid.robot.messages import rotation_of, stamp_of, yaw_of

_MAX_FRAMES = 1000


class Pose(NamedTuple):
    """Of a child frame in its parent: place (m), heading (rad), and whether it is turned upside down."""

    x: float
    y: float
    z: float
    yaw: float
    flipped: bool = False

    def then(self, inner: Pose) -> Pose:
        """The pose of `inner`, given in this frame, in this frame's parent."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        y, z = (-inner.y, -inner.z) if self.flipped else (inner.y, inner.z)
        yaw = self.yaw + (-inner.yaw if self.flipped else inner.yaw)
        return Pose(
            self.x + cos * inner.x - sin * y,
            self.y + sin * inner.x + cos * y,
            self.z + z,
            (yaw + math.pi) % (2 * math.pi) - math.pi,
            self.flipped != inner.flipped,
        )

    def inverse(self) -> Pose:
        """The parent's pose in the child."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        x, y = -(cos * self.x + sin * self.y), sin * self.x - cos * self.y
        return Pose(x, -y, self.z, self.yaw, True) if self.flipped else Pose(x, y, -self.z, -self.yaw)

    def apply(self, x: float, y: float) -> tuple[float, float]:
        """A point of the child in the parent."""
        placed = self.then(Pose(x, y, 0.0, 0.0))
        return placed.x, placed.y

    @property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """Turns the child's axes into the parent's: about the vertical, after half a turn about x if it is flipped."""
        cos, sin, up = math.cos(self.yaw), math.sin(self.yaw), -1.0 if self.flipped else 1.0
        return np.array([[cos, -sin * up, 0.0], [sin, cos * up, 0.0], [0.0, 0.0, up]])


def _clean(frame: str) -> str:
    return frame.lstrip("/")  # tf of ROS 1 wrote a slash before


class _Edge(NamedTuple):
    parent: str
    pose: Pose
    rotation: np.ndarray
    """[3, 3] all of it, of which the pose has what stays in the plane."""
    stamp_s: float
    received_s: float


class TransformTree:
    """Owns the last pose of every frame in its parent."""

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}

    def clear(self) -> None:
        """Forgets what moves (after a jump of the clock); static frames stay."""
        self._edges = {child: edge for child, edge in self._edges.items() if edge.received_s == math.inf}

    def set(
        self,
        parent: str,
        child: str,
        pose: Pose,
        stamp_s: float = 0.0,
        received_s: float = math.inf,
        rotation: Float[np.ndarray, "3 3"] | None = None,
    ) -> None:
        """One edge; `received_s` infinite: static. Without `rotation`, that of the pose in the plane."""
        parent, child = _clean(parent), _clean(child)
        require(bool(parent) and bool(child) and parent != child, "transform", (parent, child), "two different frames")
        require(all(map(math.isfinite, pose[:4])), f"transform {parent} -> {child}", pose, "finite")
        known = self._edges.get(child)
        if known is not None and known.parent == parent and stamp_s < known.stamp_s:
            return  # an older one that came late
        require(len(self._edges) < _MAX_FRAMES, "number of frames", len(self._edges), f"below {_MAX_FRAMES}")
        self._edges[child] = _Edge(parent, pose, pose.rotation if rotation is None else rotation, stamp_s, received_s)

    def take(self, transforms: Iterable[Any], received_s: float, static: bool) -> list[str]:
        """Takes in the TransformStamped of a message.

        Returns:
            What was wrong with those that were refused.
        """
        refused = []
        for transform in transforms:
            try:
                place, turn = transform.transform.translation, transform.transform.rotation
                up = 1 - 2 * (float(turn.x) ** 2 + float(turn.y) ** 2)
                pose = Pose(float(place.x), float(place.y), float(place.z), yaw_of(turn), up < 0)
                stamp = stamp_of(transform.header)
                self.set(
                    transform.header.frame_id,
                    transform.child_frame_id,
                    pose,
                    stamp,
                    math.inf if static else received_s,
                    rotation_of(turn),
                )
            except ValueError as error:
                refused.append(str(error))
        return refused

    def look_up(self, target: str, source: str, now_s: float, max_age_s: float) -> Pose:
        """Pose of `source` in `target`, along the tree.

        Raises:
            ValueError: if they are not connected, or an edge between them is older than `max_age_s`; it says which.
        """
        to_source, to_target = self._edges_between(target, source, now_s, max_age_s)
        poses = []
        for edges in (to_source, to_target):
            way = Pose(0.0, 0.0, 0.0, 0.0)
            for edge in edges:
                way = edge.pose.then(way)
            poses.append(way)
        return poses[1].inverse().then(poses[0])

    def look_up_3d(self, target: str, source: str, now_s: float, max_age_s: float) -> Float[np.ndarray, "4 4"]:
        """As `look_up`, with whole rotations: a homogeneous matrix that takes points of `source` to `target`."""
        to_source, to_target = self._edges_between(target, source, now_s, max_age_s)
        matrices = []
        for edges in (to_source, to_target):
            way = np.eye(4)
            for edge in edges:
                step = np.eye(4)
                step[:3, :3], step[:3, 3] = edge.rotation, edge.pose[:3]
                way = step @ way
            matrices.append(way)
        return np.linalg.inv(matrices[1]) @ matrices[0]

    def _edges_between(
        self, target: str, source: str, now_s: float, max_age_s: float
    ) -> tuple[list[_Edge], list[_Edge]]:
        """Edges from `source` and from `target` up to where they meet."""
        target, source = _clean(target), _clean(source)
        to_root = self._chain(source)
        from_root = self._chain(target)
        common = next((frame for frame in to_root if frame in from_root), None)
        if common is None:
            raise ValueError(f"no transform {target} -> {source}: they are not connected")
        both: list[list[_Edge]] = []
        for chain in (to_root, from_root):
            both.append([])
            for frame in chain[: chain.index(common)]:
                edge = self._edges[frame]
                age = now_s - edge.received_s
                if age > max_age_s:
                    raise ValueError(f"transform {edge.parent} -> {frame} is {age:.2f} s old")
                both[-1].append(edge)
        return both[0], both[1]

    def _chain(self, frame: str) -> list[str]:
        chain = [frame]
        while chain[-1] in self._edges:
            parent = self._edges[chain[-1]].parent
            if parent in chain:
                raise ValueError(f"transforms go round in a circle: {' -> '.join([*chain, parent])}")
            chain.append(parent)
        return chain
