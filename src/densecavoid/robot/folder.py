"""The folder that `densecavoid export` writes and robots run: networks, configuration, checksums. No code is in it, and
none is run from it: JSON, ONNX, nothing pickled.

`manifest.json` names each file by its role (`policy`; `detector`, `predictor` where a pipeline has them) with its size
and SHA-256. The networks take observations as they are: what normalises them is inside.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib
import importlib.metadata
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from densecavoid.env.observation import ObserverConfig
from densecavoid.frames import CameraConfig, LidarConfig, Observation, SensorFrame, into_robot_frame, require, seen_from
from densecavoid.networks.config_json import from_dict
from densecavoid.perception.legs import LegDetector
from densecavoid.perception.pipeline import expect_people
from densecavoid.perception.prediction_frame import Expected
from densecavoid.perception.tracker import Sighting, Tracker
from densecavoid.perception.tracks import Tracks
from densecavoid.perception.visibility import lidar_view
from densecavoid.policy.navigator import PolicyNavigator, read_observer_config
from densecavoid.policy.runtime import POLICIES, OnnxPolicy
from densecavoid.safety import NOBODY, PeopleNear

FORMAT = 1
MANIFEST = "manifest.json"
MAX_MANIFEST_BYTES = 1 << 20
MAX_FILE_BYTES = 256 << 20
_ROLES = ("policy", "detector", "predictor")


@dataclass(frozen=True)
class FolderFile:
    """One file of the folder."""

    name: str
    sha256: str
    bytes: int

    def __post_init__(self) -> None:
        plain = self.name == os.path.basename(self.name) and self.name not in ("", ".", "..", MANIFEST)
        require(plain and "\\" not in self.name and "\0" not in self.name, "name of a file", self.name, "no path")
        require(0 < self.bytes <= MAX_FILE_BYTES, f"size of {self.name!r}", self.bytes, f"at most {MAX_FILE_BYTES}")
        hexadecimal = len(self.sha256) == 64 and set(self.sha256) <= set("0123456789abcdef")
        require(hexadecimal, f"sha256 of {self.name!r}", self.sha256, "64 hexadecimal digits")


@dataclass(frozen=True)
class Manifest:
    """What is in a folder."""

    name: str
    files: dict[str, Any]
    """`FolderFile` by role."""
    observation: dict[str, Any]
    """`ObserverConfig`, as JSON: the sensors' geometry, who finds people, the prediction's horizon."""
    made_with: dict[str, Any]
    """Versions; for people."""
    format: int = FORMAT

    def __post_init__(self) -> None:
        require(self.format == FORMAT, "manifest's format", self.format, str(FORMAT))
        require(isinstance(self.name, str) and 0 < len(self.name) < 200, "manifest's name", self.name, "a name")
        for field in ("files", "observation", "made_with"):
            require(isinstance(getattr(self, field), dict), f"manifest's {field}", getattr(self, field), "a mapping")
        require("policy" in self.files, "manifest's files", sorted(self.files), "a policy among them")
        for role in self.files:
            require(role in _ROLES, "role of a file", role, ", ".join(_ROLES))

    def file(self, role: str) -> FolderFile:
        """The file of that role, checked."""
        return from_dict(FolderFile, self.files[role])


def export_folder(policy: str | Path, out: Path, others: Mapping[str, Path] | None = None) -> tuple[Path, list[str]]:
    """Writes the folder of a policy (a shipped one's name, or an ONNX file).

    Args:
        policy: who decides.
        out: the folder; made, or its files written again.
        others: networks of the perception by role.

    Returns:
        the folder, and what a robot should know (lines of text).
    """
    content = {"policy": POLICIES.read(policy)}
    loaded = OnnxPolicy(policy)
    # On a robot nobody knows people's true places, whatever the training had.
    observation = read_observer_config(loaded.card.observation, "detector")
    notes = ["people are found and foreseen by the networks that come with the package, not by files of this folder"]
    content |= {role: path.read_bytes() for role, path in (others or {}).items()}
    out.mkdir(parents=True, exist_ok=True)
    files = {}
    for role, data in content.items():
        name = f"{role}.onnx"
        (out / name).write_bytes(data)
        files[role] = dataclasses.asdict(FolderFile(name, hashlib.sha256(data).hexdigest(), len(data)))
    manifest = Manifest(
        name=loaded.card.name,
        files=files,
        observation=dataclasses.asdict(observation),
        made_with={name: importlib.metadata.version(name) for name in ("densecavoid", "numpy", "numba", "onnxruntime")},
    )
    (out / MANIFEST).write_text(json.dumps(dataclasses.asdict(manifest), indent=1) + "\n")
    return out, notes


def read_manifest(folder: Path) -> Manifest:
    """The manifest alone, checked.

    Raises:
        ValueError: if it is none.
        OSError: if it cannot be read.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise ValueError(f"{folder} is no exported folder: it has no {MANIFEST}")
    size = path.stat().st_size
    require(size <= MAX_MANIFEST_BYTES, f"size of {path}", size, f"at most {MAX_MANIFEST_BYTES} bytes")
    try:
        values = json.loads(path.read_bytes())
        require(isinstance(values, dict), str(path), type(values).__name__, "a mapping")
        manifest = from_dict(Manifest, values)
        for role in manifest.files:
            manifest.file(role)
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"{path}: {error}") from error
    return manifest


def checked_file(folder: Path, file: FolderFile) -> Path:
    """A file of the folder whose size and checksum are as the manifest says.

    Raises:
        ValueError: if they are not, or it is a link or no plain file.
    """
    path = folder / file.name
    if path.is_symlink() or not path.is_file():
        raise ValueError(f"{path} is missing, or no plain file")
    require(path.stat().st_size == file.bytes, f"size of {path}", path.stat().st_size, f"{file.bytes} bytes")
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(1 << 20):
            digest.update(block)
    require(digest.hexdigest() == file.sha256, f"sha256 of {path}", digest.hexdigest(), file.sha256)
    return path


class FolderPilot:
    """The navigator of an exported folder, as a robot runs it: a batch of one, without ground truth."""

    def __init__(self, folder: Path) -> None:
        """Loads and checks the folder.

        Raises:
            ValueError, OSError: naming what is wrong with it.
        """
        manifest = read_manifest(folder)
        policy = OnnxPolicy(checked_file(folder, manifest.file("policy")))
        try:
            from_dict(ObserverConfig, manifest.observation)
        except (ValueError, TypeError, AttributeError) as error:
            raise ValueError(f"{folder / MANIFEST}: observation: {error}") from error
        policy.card = dataclasses.replace(policy.card, observation=manifest.observation)
        self._navigator = PolicyNavigator(policy)
        # Where the policy's observer tracks nobody, the filter still wants to know who walks where: legs in the scans.
        self._legs: LegDetector | None = None
        if self._navigator.observer_config.people_from == "nothing":
            self._legs = LegDetector(self.lidar, threads=1)
            self._tracker = Tracker(1, threads=1)
            importlib.import_module("scipy.optimize")  # now, and not when the tracker first needs it
        self.name = manifest.name

    @property
    def lidar(self) -> LidarConfig:
        """The scanner that it was trained with."""
        return self._navigator.observer_config.lidar

    @property
    def camera(self) -> CameraConfig:
        """The camera that it was trained with."""
        return self._navigator.observer_config.camera

    def reset(self) -> None:
        """Forgets scans and tracks."""
        self._navigator.reset(np.ones(1, np.bool_))
        if self._legs is not None:
            self._tracker.reset(np.ones(1, np.bool_))

    def act(self, frame: SensorFrame) -> tuple[float, float]:
        """The policy's command."""
        command = self._navigator.act(frame)
        if self._legs is not None:
            found = Sighting(self._legs.detect(frame.scan_m, frame.odom_pose), lidar_view(frame.scan_m, self.lidar))
            self._tracker.update(frame.odom_pose, self._navigator.observer_config.control_dt_s, [found])
        return float(command.linear_velocity[0]), float(command.angular_velocity[0])

    @property
    def observation(self) -> Observation | None:
        """What the policy acted on last, in buffers that the next act writes again."""
        return self._navigator.observation

    @property
    def tracks(self) -> Tracks:
        """Everybody tracked, a batch of one."""
        return self._navigator.tracks if self._legs is None else self._tracker.tracks

    def expected(self, horizons_s: tuple[float, ...]) -> Expected:
        """Where everybody who is surely a person will be, in the order of their tracks."""
        return expect_people(self.tracks, self._navigator.predictor, horizons_s, np.ones(1, np.bool_))

    def prediction(self) -> np.ndarray | None:
        """What the policy saw of where people will be."""
        observation = self._navigator.observation
        return None if observation is None else observation.prediction[0].copy()

    def people(self, pose: tuple[float, float, float]) -> PeopleNear:
        """Everybody who is surely a person."""
        tracks = self.tracks
        some, where = np.flatnonzero(tracks.confirmed[0]), np.array(pose)
        if len(some) == 0:
            return NOBODY
        pos, vel = tracks.state[0, some, :2], tracks.state[0, some, 2:]
        return PeopleNear(seen_from(where, pos), into_robot_frame(where[..., 2], vel), tracks.body[0, some, 0].copy())
