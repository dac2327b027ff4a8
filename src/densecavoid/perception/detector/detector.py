"""Detectors as demo, benchmark and robot run them: ONNX Runtime on one thread. People in depth or in colour images."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32, UInt8
from PIL import Image

from densecavoid.frames import CameraConfig, require
from densecavoid.networks.onnx_files import Shelf
from densecavoid.perception.detections import Detections
from densecavoid.perception.detector.card import DetectorCard
from densecavoid.perception.detector.darknet_config import parse_config
from densecavoid.perception.detector.decode import Boxes, Decoder
from densecavoid.perception.detector.encoding import CHANNELS, PADDING_ROWS, encode_depth
from densecavoid.perception.detector.localise import localise

COCO_PERSON = 0
"""Class of people among COCO's eighty."""
_GREY = 127
_FOCAL_TOLERANCE = 0.02


DETECTORS = Shelf("detector", "densecavoid.perception", "depth-")
"""Those that come with the package."""


class OnnxDetector:
    """One network with its decoding: encoded images to boxes in pixels of the network's input."""

    def __init__(self, name_or_path: str | Path, kind: str, threshold: float | None = None, threads: int = 1) -> None:
        """Loads and checks the file.

        Raises:
            FileNotFoundError: if there is no such detector.
            ValueError: if the file is no detector of that kind.
        """
        opened = DETECTORS.open(name_or_path, threads)
        self._session, self.sha256 = opened.session, opened.sha256
        self.card = DetectorCard.from_metadata(opened.metadata, f"the file of detector {str(name_or_path)!r}")
        require(self.card.kind == kind, f"kind of {name_or_path}", self.card.kind, repr(kind))
        self.network = parse_config(self.card.network, str(name_or_path))
        inputs, outputs = [node.name for node in self._session.get_inputs()], len(self._session.get_outputs())
        require(inputs == ["images"], f"inputs of {name_or_path}", inputs, "['images']")
        require(outputs == len(self.network.heads), f"outputs of {name_or_path}", outputs, f"{len(self.network.heads)}")
        least = self.card.threshold if threshold is None else threshold
        self._decode = Decoder(self.network, least, self.card.max_overlap)

    def __call__(self, image: Float32[np.ndarray, "channels rows columns"]) -> Boxes:
        """Boxes in one encoded image."""
        heads = self._session.run(None, {"images": image[None]})
        return self._decode([np.asarray(head)[0] for head in heads])


class DepthDetector:
    """People in depth images of one camera."""

    def __init__(
        self,
        name_or_path: str | Path = "depth-yolo",
        camera: CameraConfig | None = None,
        threshold: float | None = None,
        threads: int = 1,
    ) -> None:
        """Loads and checks the file.

        Args:
            name_or_path: a shipped detector's name or an ONNX file.
            camera: where it is on the robot, and what it sees: as what the network was trained with, but for the mount.
                None: the one it was trained with.
            threshold: least confidence; the card's, unless given.
            threads: of one call.

        Raises:
            FileNotFoundError: if there is no such detector.
            ValueError: if the file is no detector for depth images, or one for another camera.
        """
        self._detector = OnnxDetector(name_or_path, "depth", threshold, threads)
        self.card, self.sha256 = self._detector.card, self._detector.sha256
        trained = self.card.camera
        assert trained is not None
        self.camera = camera or trained
        size = (self.camera.width, self.camera.height)
        require(size == (trained.width, trained.height), "camera's size", size, f"{(trained.width, trained.height)}")
        for focal, expected in zip(self.camera.focal_px, trained.focal_px, strict=True):
            near = abs(focal / expected - 1.0) < _FOCAL_TOLERANCE
            require(near, "camera's focal length (px)", focal, f"{expected:.1f}, as trained with")
        self._row_slope = self.camera.row_slopes.astype(np.float32)
        # Ranges are the network's, not the camera's: nearness must mean what it meant in training.
        self._ranges = np.float32(trained.min_range_m), np.float32(trained.max_range_m)
        self._image = np.empty((CHANNELS, trained.height + 2 * PADDING_ROWS, trained.width), np.float32)

    def find(self, depth_m: Float32[np.ndarray, "rows columns"]) -> Boxes:
        """Boxes of people, bodies' hidden parts included, in pixels of the image and cut at its edges.

        Raises:
            ValueError: if the image is not of the camera's size.
        """
        camera = self.camera
        shape = (camera.height, camera.width)
        require(depth_m.shape == shape, "depth_m's shape", depth_m.shape, f"{shape}")
        pitch = float(camera.mount_pitch_rad)
        encode_depth(depth_m, *self._ranges, float(camera.mount_height_m), pitch, self._row_slope, self._image)
        found = self._detector(self._image)
        box = found.box
        box[:, 1::2] -= PADDING_ROWS
        box[:, 0::2] = box[:, 0::2].clip(0.0, camera.width)
        box[:, 1::2] = box[:, 1::2].clip(0.0, camera.height)
        return found._replace(box=box)

    def mount(self, mount_x_m: float, height_m: float, pitch_rad: float) -> None:
        """Tells where the camera is from now on: ahead of the robot's centre, above the ground, looking down."""
        self.camera = dataclasses.replace(
            self.camera, mount_x_m=mount_x_m, mount_height_m=height_m, mount_pitch_rad=pitch_rad
        )

    def place(
        self, boxes: Boxes, depth_m: Float32[np.ndarray, "rows columns"], odom_pose: Float[np.ndarray, "3"]
    ) -> Detections:
        """Where the people in the boxes that `find` found in an image stand, given the robot's pose."""
        return localise(boxes, depth_m, self.camera, self.card.place_error, odom_pose)

    def detect(
        self, depth_m: Float32[np.ndarray, "rows columns"], odom_pose: Float[np.ndarray, "3"] | None = None
    ) -> Detections:
        """Where people stand: a batch of one, in the odometry frame of `odom_pose` (the robot's, unless given).

        Raises:
            ValueError: if the image is not of the camera's size.
        """
        pose = np.zeros(3) if odom_pose is None else odom_pose
        return self.place(self.find(depth_m), depth_m, pose)


class RgbDetector:
    """COCO's things, or people alone, in colour images of any size."""

    def __init__(self, path: str | Path, threshold: float | None = None, threads: int = 1) -> None:
        """Loads an ONNX file that `export.import_darknet` wrote.

        Raises:
            FileNotFoundError: if there is no such file.
            ValueError: if it is no detector for colour images.
        """
        self._detector = OnnxDetector(path, "rgb", threshold, threads)
        self.card, self.sha256 = self._detector.card, self._detector.sha256

    def find(self, rgb: UInt8[np.ndarray, "rows columns 3"], label: int | None = COCO_PERSON) -> Boxes:
        """Boxes in pixels of the image, cut at its edges; of one class (people), or of all for None."""
        shape = self._detector.network.input
        encoded, scale, left, top = letterbox(rgb, shape.width, shape.height)
        found = self._detector(encoded)
        wanted = np.ones(len(found.label), np.bool_) if label is None else found.label == label
        box = found.box[wanted]
        box[:, 0::2] = ((box[:, 0::2] - left) / scale).clip(0.0, rgb.shape[1])
        box[:, 1::2] = ((box[:, 1::2] - top) / scale).clip(0.0, rgb.shape[0])
        return Boxes(box, found.confidence[wanted], found.label[wanted])


def letterbox(
    rgb: UInt8[np.ndarray, "rows columns 3"], width: int, height: int
) -> tuple[Float32[np.ndarray, "3 height width"], float, int, int]:
    """The image in [0, 1], as large as fits the network's input without distortion, on grey.

    Returns:
        The encoded image, pixels of it for each of the original, and its left and top margins in pixels.
    """
    rows, columns = rgb.shape[:2]
    scale = min(width / columns, height / rows)
    size = max(1, math.floor(columns * scale + 0.5)), max(1, math.floor(rows * scale + 0.5))
    left, top = (width - size[0]) // 2, (height - size[1]) // 2
    canvas = np.full((height, width, 3), _GREY, np.uint8)
    resized = np.asarray(Image.fromarray(rgb).resize(size, Image.Resampling.BILINEAR))
    canvas[top : top + size[1], left : left + size[0]] = resized
    return np.ascontiguousarray(canvas.transpose(2, 0, 1), dtype=np.float32) / np.float32(255.0), scale, left, top
