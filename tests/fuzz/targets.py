"""The readers of binary files as functions of bytes, each with seeds to begin from. Knows no fuzzer (`run`).

A reader may answer with what it read, or with a ValueError or an OSError. Everything else that it raises, a hang, and
memory that runs away are faults.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import json
import struct
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

REFUSALS = (ValueError, OSError)


@dataclass(frozen=True)
class Target:
    """One reader."""

    read: Callable[[Path], object]
    """Of a file."""
    suffix: str
    seeds: Callable[[], list[bytes]]
    """Good files, small ones."""
    instrument: tuple[str, ...]
    """Modules whose branches guide the fuzzer; none that numba compiles."""
    needs: tuple[str, ...] = ()
    """Modules without which there is nothing to fuzz."""
    wrap: Callable[[bytes], bytes] = bytes
    """From the fuzzer's bytes to the file's."""

    @property
    def missing(self) -> list[str]:
        """Modules that are needed and not installed."""
        return [name for name in self.needs if importlib.util.find_spec(name) is None]

    def run(self, data: bytes) -> bool:
        """Reads a file of these bytes; whether it was one."""
        path = _scratch() / f"input{self.suffix}"
        path.write_bytes(self.wrap(data))
        try:
            self.read(path)
        except REFUSALS:
            return False
        return True


@cache
def _scratch() -> Path:
    return Path(tempfile.mkdtemp(prefix="densecavoid-fuzz-"))


# -- recordings --------------------------------------------------------------------------------------------------------


def _read_bag(path: Path) -> object:
    """As `densecavoid replay` does, with a pilot that needs no networks."""
    from densecavoid.robot.bags import Bag, Topics
    from densecavoid.robot.config import RobotSettings
    from densecavoid.robot.faults import ScriptedPilot
    from densecavoid.robot.messages import Mount
    from densecavoid.robot.runtime import RobotRuntime

    runtime = RobotRuntime(ScriptedPilot(), RobotSettings(lidar_mount=Mount()), threaded=False)
    handlers = {
        "scan": runtime.on_scan,
        "depth": runtime.on_depth,
        "odom": runtime.on_odom,
        "goal": lambda message, now_s, _: runtime.on_goal(message, now_s),
        "camera_info": lambda message, *_: runtime.on_camera_info(message),
        "tf": lambda message, now_s, _: runtime.on_transforms(message.transforms, now_s, False),
        "tf_static": lambda message, now_s, _: runtime.on_transforms(message.transforms, now_s, True),
    }
    with Bag(path) as bag:
        for item in bag.messages(bag.choose(Topics())):
            handlers[item.kind](item.message, item.time_s, item.time_s)
    return runtime.step(0.0, 0.0)


def _bag_seeds(suffix: str) -> Callable[[], list[bytes]]:
    def seeds() -> list[bytes]:
        from densecavoid.robot.faults import ScriptedPilot
        from densecavoid.robot.pilot import blank_frame

        recordings = _helper("robot/recordings.py")
        frame = blank_frame(ScriptedPilot.lidar, ScriptedPilot.camera)
        frame.scan_m[:], frame.depth_m[:] = 2.0, 1.5
        with tempfile.TemporaryDirectory() as folder:
            place = recordings.write_recording(Path(folder) / "seed", suffix, [frame] * 3)
            file = place if place.is_file() else next(place.glob(f"*{suffix}"))
            return [file.read_bytes()]

    return seeds


def _helper(name: str) -> Any:
    """A module of the tests beside this folder."""
    spec = importlib.util.spec_from_file_location("helper", Path(__file__).resolve().parents[1] / name)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


# -- networks ----------------------------------------------------------------------------------------------------------


def _onnx(
    card_key: str, card: bytes, inputs: Sequence[tuple[str, int, list[int]]], outputs: Sequence[tuple[str, int]]
) -> bytes:
    """A graph with these inputs that computes nothing, and with a card."""
    from onnx import TensorProto, helper

    ins = [helper.make_tensor_value_info(name, kind, ["batch", *shape]) for name, kind, shape in inputs]
    outs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", size]) for name, size in outputs]
    first = next(node for node in inputs if node[1] == TensorProto.FLOAT)[0]
    nodes = [helper.make_node("Flatten", [first], [name]) for name, _ in outputs]
    model = helper.make_model(
        helper.make_graph(nodes, "g", ins, outs), opset_imports=[helper.make_opsetid("", 18)], ir_version=9
    )
    entry = model.metadata_props.add()
    entry.key, entry.value = card_key, card.decode("utf-8", "replace")
    return model.SerializeToString()


def _policy_onnx(card: bytes) -> bytes:
    from onnx import TensorProto

    floats, bytes_ = TensorProto.FLOAT, TensorProto.UINT8
    inputs = [("lidar", floats, [3, 512]), ("camera", bytes_, [60, 80]), ("goal", floats, [2])]
    inputs += [("velocity", floats, [2]), ("prediction", bytes_, [60, 80]), ("worth", floats, [25])]
    chooses = b'"log_std": null' in card
    return _onnx("densecavoid.policy", card, inputs, [("mean", 2), ("log_probs", 25)] if chooses else [("mean", 2)])


def _detector_onnx(card: bytes) -> bytes:
    return _onnx("densecavoid.detector", card, [("images", 1, [4, 64, 80])], [("head_0", 2), ("head_1", 2)])


def _predictor_onnx(card: bytes) -> bytes:
    return _onnx("densecavoid.predictor", card, [("own", 1, [32]), ("neighbours", 1, [4, 4])], [("gaussians", 20)])


def _shipped_card(package: str, name: str, key: str) -> bytes:
    from densecavoid.networks.onnx_files import Shelf

    return Shelf("network", package).open(name, 1).metadata[key].encode()


def _policy_card(name: str = "densecavoid") -> bytes:
    card = json.loads(_shipped_card("densecavoid.policy", name, "densecavoid.policy"))
    return json.dumps(card | {"training": {}}).encode()


def _policy_cards() -> list[bytes]:
    """Of one that chooses among commands, and of a Gaussian."""
    return [_policy_card(), _policy_card("depth-lidar")]


def _detector_card() -> bytes:
    card = json.loads(_shipped_card("densecavoid.perception", "depth-yolo", "densecavoid.detector"))
    return json.dumps(card | {"training": {}}).encode()


def _predictor_card() -> bytes:
    card = json.loads(_shipped_card("densecavoid.perception", "predictor-compact-robot", "densecavoid.predictor"))
    return json.dumps(card | {"training": {}}).encode()


def _read_policy(path: Path) -> object:
    from densecavoid.policy.navigator import load_policy

    return load_policy(path, people_from="nothing")


def _read_detector(path: Path) -> object:
    from densecavoid.perception.detector.detector import DepthDetector

    return DepthDetector(path)


def _read_predictor(path: Path) -> object:
    from densecavoid.perception.predictor.learned import LearnedPredictor

    return LearnedPredictor(path)


def _safetensors(key: str, card: bytes) -> bytes:
    """A file with one tensor and a card."""
    tensor = {"dtype": "F32", "shape": [2], "data_offsets": [0, 8]}
    metadata = {key: card.decode("utf-8", "replace")}
    header = json.dumps({"__metadata__": metadata, "log_std": tensor}).encode()
    return struct.pack("<Q", len(header)) + header + bytes(8)


def _read_safetensors(path: Path) -> object:
    """The file is taken for each of the three; the first that it is is read."""
    from densecavoid.perception.detector.export import load_detector
    from densecavoid.perception.predictor.export import load_predictor
    from densecavoid.policy.export import load_safetensors

    refusals = []
    for load in (load_safetensors, load_detector, load_predictor):
        try:
            return load(path)
        except REFUSALS as error:
            refusals.append(error)
    raise refusals[0]


def _safetensors_seeds() -> list[bytes]:
    cards = (
        ("densecavoid.policy", _policy_card()),
        ("densecavoid.detector", _detector_card()),
        ("densecavoid.predictor", _predictor_card()),
    )
    return [_safetensors(key, card) for key, card in cards]


# -- other files -------------------------------------------------------------------------------------------------------


def _read_legs(path: Path) -> object:
    from densecavoid.perception.legs import load_forest

    return load_forest(path)


def _legs_seeds() -> list[bytes]:
    from densecavoid.perception.leg_segments import FEATURES

    arrays = {
        "features": np.array(FEATURES),
        "feature": np.zeros((2, 3), np.int8),
        "threshold": np.zeros((2, 3), np.float32),
        "value": np.zeros((2, 4), np.float32),
        "base": np.float64(0.0),
    }
    seeds = []
    for save in (np.savez, np.savez_compressed):
        stream = io.BytesIO()
        save(stream, allow_pickle=False, **arrays)
        seeds.append(stream.getvalue())
    return seeds


def _read_map(path: Path) -> object:
    from densecavoid.scenarios.ros_map import read_ros_map

    description = path.with_suffix(".yaml")
    thresholds = "occupied_thresh: 0.65, free_thresh: 0.2"
    description.write_text(f"{{image: {path.name}, resolution: 0.05, origin: [0, 0, 0], negate: 0, {thresholds}}}")
    return read_ros_map(description)


def _map_seeds() -> list[bytes]:
    from PIL import Image

    grey = np.linspace(0, 255, 48).astype(np.uint8).reshape(6, 8)
    seeds = [b"P2\n# made by hand\n4 2\n255\n0 128 255 7\n1 2 3 4\n"]
    for mode, kind in (("L", "PPM"), ("L", "PNG"), ("RGBA", "PNG"), ("P", "PNG"), ("1", "PNG"), ("I;16", "PNG")):
        stream = io.BytesIO()
        image = Image.fromarray(grey.astype(np.uint16)) if mode == "I;16" else Image.fromarray(grey).convert(mode)
        image.save(stream, kind)
        seeds.append(stream.getvalue())
    return seeds


_DARKNET = "[net]\nwidth=32\nheight=32\nchannels=3\n[convolutional]\nfilters=2\nsize=1\nstride=1\nactivation=linear\n"


def _darknet_config() -> str:
    return (
        _DARKNET
        + "[convolutional]\nbatch_normalize=1\nfilters=18\nsize=1\nstride=1\nactivation=linear\n"
        + ("[yolo]\nmask=0,1,2\nanchors=1,2,3,4,5,6\nclasses=1\nnum=3\n")
    )


def _read_darknet(path: Path) -> object:
    from densecavoid.perception.detector.darknet_config import parse_config
    from densecavoid.perception.detector.darknet_weights import read_weights

    return read_weights(path, parse_config(_darknet_config(), "fuzz"))


def _darknet_seeds() -> list[bytes]:
    from densecavoid.perception.detector.darknet_config import parse_config
    from densecavoid.perception.detector.darknet_weights import num_weights

    numbers = np.ones(num_weights(parse_config(_darknet_config(), "fuzz")), "<f4").tobytes()
    return [struct.pack("<3iQ", 0, 2, 0, 5) + numbers, struct.pack("<4i", 0, 1, 0, 5) + numbers]


def _read_mesh(path: Path) -> object:
    from densecavoid.sim.mesh import load_mesh

    return load_mesh(path, allow_open=True)


def _mesh_seeds(suffix: str) -> Callable[[], list[bytes]]:
    def seeds() -> list[bytes]:
        import trimesh

        exported = trimesh.creation.box((1.0, 2.0, 0.5)).export(file_type=suffix[1:])
        return [exported if isinstance(exported, bytes) else str(exported).encode()]

    return seeds


_BAGS = ("densecavoid.robot.bags", "densecavoid.robot.messages", "rosbags")
_CARDS = ("densecavoid.networks.config_json", "json")
TARGETS: dict[str, Target] = {
    "bag": Target(_read_bag, ".bag", _bag_seeds(".bag"), _BAGS, ("rosbags",)),
    "mcap": Target(_read_bag, ".mcap", _bag_seeds(".mcap"), _BAGS, ("rosbags",)),
    "db3": Target(_read_bag, ".db3", _bag_seeds(".db3"), _BAGS, ("rosbags",)),
    "onnx": Target(_read_policy, ".onnx", lambda: [_policy_onnx(card) for card in _policy_cards()], _CARDS, ("onnx",)),
    "policy-card": Target(_read_policy, ".onnx", _policy_cards, _CARDS, ("onnx",), _policy_onnx),
    "detector-card": Target(
        _read_detector,
        ".onnx",
        lambda: [_detector_card()],
        (*_CARDS, "densecavoid.perception.detector.darknet_config"),
        ("onnx",),
        _detector_onnx,
    ),
    "predictor-card": Target(_read_predictor, ".onnx", lambda: [_predictor_card()], _CARDS, ("onnx",), _predictor_onnx),
    "safetensors": Target(
        _read_safetensors,
        ".safetensors",
        _safetensors_seeds,
        (*_CARDS, "densecavoid.networks.torch_files", "densecavoid.perception.detector.darknet_config"),
        ("torch", "safetensors"),
    ),
    "legs": Target(_read_legs, ".npz", _legs_seeds, ("densecavoid.networks.array_files", "zipfile")),
    "map": Target(_read_map, ".png", _map_seeds, ("PIL",)),
    "darknet": Target(_read_darknet, ".weights", _darknet_seeds, ("densecavoid.perception.detector.darknet_weights",)),
    "stl": Target(_read_mesh, ".stl", _mesh_seeds(".stl"), ("trimesh",), ("trimesh",)),
    "ply": Target(_read_mesh, ".ply", _mesh_seeds(".ply"), ("trimesh",), ("trimesh",)),
    "glb": Target(_read_mesh, ".glb", _mesh_seeds(".glb"), ("trimesh",), ("trimesh",)),
}
"""By name."""


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Without what libraries print about broken files."""
    import logging
    import warnings

    logging.disable(logging.CRITICAL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
