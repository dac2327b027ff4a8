"""The folder that `densecavoid export` writes (`folder_export`) and robots run: networks, configuration, checksums. No
code is in it, and none is run from it: JSON, ONNX and NumPy's arrays, nothing pickled.

`manifest.json` names each file by its role with its size and SHA-256; `manifest.json.sha256` is the manifest's own, as
`sha256sum -c` reads it. The networks take observations as they are: what normalises them is inside.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from densecavoid.env.observation import ObserverConfig
from densecavoid.frames import require
from densecavoid.networks.config_json import from_dict
from densecavoid.perception.networks import PeopleNetworks
from densecavoid.perception.predictor.registry import SHIPPED_WEIGHTS
from densecavoid.policy.card import PolicyCard
from densecavoid.policy.runtime import OnnxPolicy

FORMAT = 2
MANIFEST = "manifest.json"
MANIFEST_SUM = "manifest.json.sha256"
MAX_MANIFEST_BYTES = 1 << 20
MAX_FILE_BYTES = 256 << 20
FILE_NAMES = {"policy": "policy.onnx", "detector": "detector.onnx", "legs": "legs.npz", "predictor": "predictor.onnx"}
"""By role: who decides, finds people in depth images, finds their legs in scans, says where they will be."""


@dataclass(frozen=True)
class FolderFile:
    """One file of the folder."""

    name: str
    sha256: str
    bytes: int

    def __post_init__(self) -> None:
        plain = self.name == os.path.basename(self.name) and self.name not in ("", ".", "..", MANIFEST, MANIFEST_SUM)
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
    """`ObserverConfig`, as JSON: the sensors' geometry, the predictor, the prediction's horizons."""
    notes: list[str]
    """Who finds people and who foresees them; for people."""
    made_with: dict[str, Any]
    """Versions; for people."""
    format: int = FORMAT

    def __post_init__(self) -> None:
        require(self.format == FORMAT, "manifest's format", self.format, f"{FORMAT}: export it again")
        require(isinstance(self.name, str) and 0 < len(self.name) < 200, "manifest's name", self.name, "a name")
        for field in ("files", "observation", "made_with"):
            require(isinstance(getattr(self, field), dict), f"manifest's {field}", getattr(self, field), "a mapping")
        lines = isinstance(self.notes, list) and all(isinstance(note, str) for note in self.notes)
        require(lines, "manifest's notes", self.notes, "a list of lines")
        require("policy" in self.files, "manifest's files", sorted(self.files), "a policy among them")
        for role in self.files:
            require(role in FILE_NAMES, "role of a file", role, ", ".join(FILE_NAMES))

    def file(self, role: str) -> FolderFile:
        """The file of that role, checked."""
        return from_dict(FolderFile, self.files[role])

    def observer(self) -> ObserverConfig:
        """How observations are made, checked."""
        return from_dict(ObserverConfig, self.observation)


def roles_needed(card: PolicyCard, observation: ObserverConfig) -> tuple[str, ...]:
    """Which files a policy needs to drive: no detector if it does not look at people, no predictor if that is none with
    weights. Legs it always needs: the safety filter wants to know who walks where."""
    needed = {
        "policy": True,
        "detector": card.sensors == "densecavoid",
        "legs": True,
        "predictor": observation.predictor in SHIPPED_WEIGHTS,
    }
    return tuple(role for role in FILE_NAMES if needed[role])


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Writes it and its checksum."""
    content = (json.dumps(dataclasses.asdict(manifest), indent=1) + "\n").encode()
    (folder / MANIFEST).write_bytes(content)
    (folder / MANIFEST_SUM).write_bytes(_sum_line(content))


def _sum_line(content: bytes) -> bytes:
    return f"{hashlib.sha256(content).hexdigest()}  {MANIFEST}\n".encode()


def read_manifest(folder: Path) -> Manifest:
    """The manifest alone, checked.

    Raises:
        ValueError: if it is none, or not the one that its checksum was taken of.
        OSError: if it cannot be read.
    """
    path, sum_path = folder / MANIFEST, folder / MANIFEST_SUM
    if not path.is_file():
        raise ValueError(f"{folder} is no exported folder: it has no {MANIFEST}")
    if not sum_path.is_file():
        raise ValueError(f"{sum_path} is missing: export the folder again")
    size = path.stat().st_size
    require(size <= MAX_MANIFEST_BYTES, f"size of {path}", size, f"at most {MAX_MANIFEST_BYTES} bytes")
    content = path.read_bytes()
    expected = _sum_line(content)
    with sum_path.open("rb") as stream:
        found = stream.read(len(expected) + 1)
    require(found == expected, f"checksum in {sum_path}", found[:64], f"that of {path}; one of them was changed")
    try:
        values = json.loads(content)
        require(isinstance(values, dict), str(path), type(values).__name__, "a mapping")
        manifest = from_dict(Manifest, values)
        for role in manifest.files:
            manifest.file(role)
        manifest.observer()
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


class OpenedFolder(NamedTuple):
    """All that drives, from one folder."""

    name: str
    policy: OnnxPolicy
    """Its card has the manifest's observation."""
    networks: PeopleNetworks


def open_folder(folder: Path) -> OpenedFolder:
    """Checks every file, and loads the policy.

    Raises:
        ValueError, OSError: naming the file that is missing, too many, changed, or none of its kind.
    """
    manifest = read_manifest(folder)
    paths = {role: checked_file(folder, manifest.file(role)) for role in manifest.files}
    policy = OnnxPolicy(paths["policy"])
    policy.card = dataclasses.replace(policy.card, observation=manifest.observation)
    needed = roles_needed(policy.card, manifest.observer())
    require(set(paths) == set(needed), f"files of {folder / MANIFEST}", sorted(paths), f"exactly {', '.join(needed)}")
    networks = PeopleNetworks(legs=paths["legs"], predictor=paths.get("predictor"))
    if "detector" in paths:
        networks = dataclasses.replace(networks, detector=paths["detector"])
    return OpenedFolder(manifest.name, policy, networks)
