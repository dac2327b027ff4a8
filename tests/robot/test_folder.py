"""Exported folders: they drive as what they were made of, with their own networks, and refuse whatever was changed."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings import drive

from densecavoid.env.observation import ObserverConfig
from densecavoid.frames import SensorFrame
from densecavoid.policy.folder import MANIFEST, MANIFEST_SUM, read_manifest
from densecavoid.policy.folder_export import export_folder
from densecavoid.policy.navigator import load_policy
from densecavoid.policy.runtime import POLICIES
from densecavoid.robot.folder import FolderPilot


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_folder("densecavoid", tmp_path_factory.mktemp("export") / "exported")[0]


@pytest.fixture(scope="module")
def episode() -> list[SensorFrame]:
    """Among people whom the camera sees and the lidar too."""
    return drive(6.0, "dense-ped", seed=1)


def change(folder: Path, to: Path, edit: Callable[[dict[str, Any]], None]) -> Path:
    """A copy whose manifest is edited, with the checksum that belongs to it."""
    copy = Path(shutil.copytree(folder, to))
    manifest = json.loads((copy / MANIFEST).read_text())
    edit(manifest)
    seal(copy, json.dumps(manifest))
    return copy


def seal(folder: Path, manifest: str) -> None:
    (folder / MANIFEST).write_text(manifest)
    digest = hashlib.sha256(manifest.encode()).hexdigest()
    (folder / MANIFEST_SUM).write_text(f"{digest}  {MANIFEST}\n")


def with_card(path: Path, key: str, edit: Callable[[dict[str, Any]], None], to: Path) -> Path:
    """An ONNX file with another card."""
    onnx = pytest.importorskip("onnx")
    model = onnx.load_from_string(path.read_bytes())
    (entry,) = (entry for entry in model.metadata_props if entry.key == key)
    card = json.loads(entry.value)
    edit(card)
    entry.value = json.dumps(card)
    to.write_bytes(model.SerializeToString())
    return to


def test_it_drives_a_recorded_episode_as_the_policy_that_ships(folder: Path, episode: list[SensorFrame]) -> None:
    shipped, loaded, pilot = load_policy("densecavoid"), load_policy(folder), FolderPilot(folder)
    commands, people = [], 0
    for frame in episode:
        expected, found, by_pilot = shipped.act(frame), loaded.act(frame), pilot.act(frame)
        linear, angular = float(expected.linear_velocity[0]), float(expected.angular_velocity[0])
        assert (float(found.linear_velocity[0]), float(found.angular_velocity[0])) == (linear, angular)
        assert by_pilot == (linear, angular)
        commands.append((linear, angular))
        people = max(people, len(pilot.people((0.0, 0.0, 0.0)).pos_r))
    assert np.std(commands, axis=0).min() > 0.01 and people >= 2, "the test needs something to happen"


def test_it_says_what_is_in_it_and_what_is_not(folder: Path) -> None:
    assert sorted(path.name for path in folder.iterdir()) == [
        "detector.onnx",
        "legs.npz",
        MANIFEST,
        MANIFEST_SUM,
        "policy.onnx",
    ]
    notes = " ".join(read_manifest(folder).notes)
    assert "detector.onnx" in notes and "legs.npz" in notes
    assert "foreseen by constant-velocity: no network for that" in notes


def test_people_are_found_by_the_folders_own_detector_and_legs(episode: list[SensorFrame], tmp_path: Path) -> None:
    """A detector that is never sure enough finds nobody, legs that are never sure neither: tracks differ."""
    from densecavoid.perception.detector.detector import DETECTORS
    from densecavoid.perception.legs import load_forest

    (tmp_path / "good.onnx").write_bytes(DETECTORS.read("depth-yolo"))

    def never(card: dict[str, Any]) -> None:
        card["threshold"] = 0.999999

    blind = with_card(tmp_path / "good.onnx", "densecavoid.detector", never, tmp_path / "blind.onnx")
    exported, _ = export_folder("densecavoid", tmp_path / "exported", detector=blind)

    def tracked(where: Path) -> tuple[int, int]:
        """Tracks, and those that a camera has seen, summed over the episode."""
        pilot, count, by_camera = FolderPilot(where), 0, 0
        for frame in episode[:40]:
            pilot.act(frame)
            confirmed = pilot.tracks.confirmed[0]
            count, by_camera = count + confirmed.sum(), by_camera + (confirmed & pilot.tracks.by_camera[0]).sum()
        return int(count), int(by_camera)

    usual, _ = export_folder("densecavoid", tmp_path / "usual")
    assert tracked(usual)[1] > 0
    by_legs, by_camera = tracked(exported)
    assert by_camera == 0 and by_legs > 0
    forest = load_forest(exported / "legs.npz")
    from densecavoid.perception.leg_training import save_forest

    save_forest(forest._replace(base=-50.0), exported / "legs.npz")
    content = (exported / "legs.npz").read_bytes()

    def renew(manifest: dict[str, Any]) -> None:
        manifest["files"]["legs"] |= {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}

    assert tracked(change(exported, tmp_path / "legless", renew)) == (0, 0)


@pytest.fixture(scope="module")
def foreseeing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped policy, as if it had been trained with a predictor that has weights."""
    where = tmp_path_factory.mktemp("foreseeing")
    (where / "good.onnx").write_bytes(POLICIES.read("densecavoid"))

    def foresee(card: dict[str, Any]) -> None:
        card["observation"] |= {"predictor": "compact", "horizons_s": [0.4, 0.8]}

    return with_card(where / "good.onnx", "densecavoid.policy", foresee, where / "policy.onnx")


def test_a_learned_predictor_is_in_the_folder_and_used(
    foreseeing: Path, episode: list[SensorFrame], tmp_path: Path
) -> None:
    folder, notes = export_folder(foreseeing, tmp_path / "exported")
    assert (folder / "predictor.onnx").is_file() and "compact (predictor.onnx)" in notes[1]
    navigator, pilot = load_policy(foreseeing), FolderPilot(folder)
    expected: Any = load_policy(folder).predictor
    assert expected.sha256 == hashlib.sha256((folder / "predictor.onnx").read_bytes()).hexdigest()
    for frame in episode[:30]:
        command = navigator.act(frame)
        assert pilot.act(frame) == (float(command.linear_velocity[0]), float(command.angular_velocity[0]))
    # The policy that ships leaves no predictor behind where it is exported next.
    export_folder("densecavoid", folder)
    assert not (folder / "predictor.onnx").exists()


def test_a_policy_that_does_not_look_at_people_needs_no_detector_but_legs_for_the_filter(
    episode: list[SensorFrame], tmp_path: Path
) -> None:
    (tmp_path / "good.onnx").write_bytes(POLICIES.read("densecavoid"))

    def depth_and_lidar(card: dict[str, Any]) -> None:
        card["sensors"] = "depth-lidar"

    policy = with_card(tmp_path / "good.onnx", "densecavoid.policy", depth_and_lidar, tmp_path / "policy.onnx")
    folder, notes = export_folder(policy, tmp_path / "exported")
    assert not (folder / "detector.onnx").exists() and "does not look at people" in notes[0]
    pilot = FolderPilot(folder)
    for frame in episode[:40]:
        pilot.act(frame)
    assert len(pilot.people((0.0, 0.0, 0.0)).pos_r) > 0


def test_networks_that_do_not_fit_are_refused_when_exporting(foreseeing: Path, tmp_path: Path) -> None:
    out = tmp_path / "exported"
    with pytest.raises(ValueError, match=r"expected none: 'densecavoid' uses 'constant-velocity'"):
        export_folder("densecavoid", out, predictor="predictor-compact-robot")
    with pytest.raises(ValueError, match=r"kind of .*'robust-tp', expected 'compact'"):
        export_folder(foreseeing, out, predictor="predictor-robust-tp-robot")

    def farther(card: dict[str, Any]) -> None:
        card["observation"]["horizons_s"] = [2.0]

    with pytest.raises(ValueError, match=r"horizons_s is \(2\.0,\), expected .*at most 1\.2 s"):
        export_folder(with_card(foreseeing, "densecavoid.policy", farther, tmp_path / "far.onnx"), out)
    with pytest.raises(ValueError, match="not a detector"):
        export_folder(foreseeing, out, detector=foreseeing)
    with pytest.raises(FileNotFoundError, match="no detector 'nobody'"):
        export_folder("densecavoid", out, detector="nobody")


@pytest.mark.parametrize("name", ["policy.onnx", "detector.onnx", "legs.npz", MANIFEST, MANIFEST_SUM])
def test_a_changed_byte_in_any_file_is_refused_and_so_is_a_missing_one(folder: Path, name: str, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(folder, tmp_path / "copy"))
    good = (copy / name).read_bytes()
    for place in (0, len(good) // 2, len(good) - 1):
        bad = bytearray(good)
        bad[place] ^= 1
        (copy / name).write_bytes(bad)
        for load in (load_policy, FolderPilot):
            with pytest.raises(ValueError, match=name):
                load(copy)
    (copy / name).write_bytes(good[:-1])
    with pytest.raises(ValueError, match=name):
        load_policy(copy)
    (copy / name).unlink()
    with pytest.raises(ValueError, match=name):
        load_policy(copy)
    (copy / name).write_bytes(good)
    load_policy(copy)


def test_manifests_that_ask_for_the_wrong_files_are_refused(folder: Path, tmp_path: Path) -> None:
    for number, name in enumerate(("../policy.onnx", "/etc/passwd", "a/b", "", MANIFEST, MANIFEST_SUM)):

        def elsewhere(manifest: dict[str, Any], name: str = name) -> None:
            manifest["files"]["policy"]["name"] = name

        with pytest.raises(ValueError, match="name of a file"):
            read_manifest(change(folder, tmp_path / str(number), elsewhere))
    linked = Path(shutil.copytree(folder, tmp_path / "linked"))
    (linked / "detector.onnx").unlink()
    (linked / "detector.onnx").symlink_to(folder / "detector.onnx")
    with pytest.raises(ValueError, match="no plain file"):
        FolderPilot(linked)

    def without_detector(manifest: dict[str, Any]) -> None:
        del manifest["files"]["detector"]

    with pytest.raises(ValueError, match=r"expected exactly policy, detector, legs"):
        FolderPilot(change(folder, tmp_path / "less", without_detector))

    def foresees(manifest: dict[str, Any]) -> None:
        manifest["observation"]["predictor"] = "compact"

    with pytest.raises(ValueError, match=r"expected exactly policy, detector, legs, predictor"):
        FolderPilot(change(folder, tmp_path / "blind", foresees))

    def old(manifest: dict[str, Any]) -> None:
        manifest["format"] = 1

    with pytest.raises(ValueError, match="format is 1, expected 2: export it again"):
        FolderPilot(change(folder, tmp_path / "old", old))

    def truth(manifest: dict[str, Any]) -> None:
        manifest["observation"]["people_from"] = "truth"

    # A robot finds people itself, whatever a file asks for.
    assert not load_policy(change(folder, tmp_path / "truth", truth)).privileged
    with pytest.raises(ValueError, match="no exported folder"):
        FolderPilot(tmp_path)


LEAF = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8))
KEYS = st.sampled_from(["name", "files", "observation", "policy", "bytes", "format", "sha256", "made_with", "notes"])
INNER = st.one_of(LEAF, st.lists(LEAF, max_size=3), st.dictionaries(KEYS, LEAF, max_size=4))
MIDDLE = st.one_of(INNER, st.dictionaries(KEYS, INNER, max_size=4))
JSON = st.one_of(MIDDLE, st.dictionaries(KEYS, MIDDLE, max_size=6))


@settings(max_examples=150, deadline=None)
@given(values=JSON)
def test_any_manifest_is_one_or_a_value_error(values: Any, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("fuzz")
    seal(folder, json.dumps(values))
    with pytest.raises(ValueError):
        FolderPilot(folder)


OBSERVATION = st.dictionaries(
    st.sampled_from([field.name for field in dataclasses.fields(ObserverConfig)]), MIDDLE, max_size=3
)


@settings(max_examples=100, deadline=None)
@given(observation=OBSERVATION)
def test_any_observation_is_one_or_a_value_error(
    observation: dict[str, Any], folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    copy = tmp_path_factory.mktemp("fuzz")
    manifest = json.loads((folder / MANIFEST).read_text())
    manifest["observation"] |= observation
    seal(copy, json.dumps(manifest))
    try:
        read = read_manifest(copy)
    except ValueError as error:
        assert MANIFEST in str(error)
    else:
        assert isinstance(read.observer(), ObserverConfig)


@pytest.mark.parametrize("role", ["policy", "detector", "legs"])
def test_any_bytes_as_a_network_are_refused(folder: Path, role: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    name = json.loads((folder / MANIFEST).read_text())["files"][role]["name"]
    good = (folder / name).read_bytes()
    for index in range(10):
        bad = good[: int(rng.integers(1, len(good)))] if index % 2 else rng.bytes(500)

        def renew(manifest: dict[str, Any], bad: bytes = bad) -> None:
            manifest["files"][role] |= {"bytes": len(bad), "sha256": hashlib.sha256(bad).hexdigest()}

        where = change(folder, tmp_path / str(index), renew)
        (where / name).write_bytes(bad)
        with pytest.raises(ValueError):
            FolderPilot(where)
