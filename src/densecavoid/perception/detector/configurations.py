"""The networks that come with the package, as the text of Darknet configurations: YOLOv3 and YOLOv3-tiny as published,
and the compact one for people in depth images.
"""

from __future__ import annotations

_ANCHORS = ((10, 13), (16, 30), (33, 23), (30, 61), (62, 45), (59, 119), (116, 90), (156, 198), (373, 326))
_TINY_ANCHORS = ((10, 14), (23, 27), (37, 58), (81, 82), (135, 169), (344, 319))
_DEPTH_ANCHORS = ((7.2, 25.4), (9.5, 27.3), (10.6, 35.1), (13.4, 38.2), (17.1, 42.2), (22.7, 45.3))
"""K-means of people's boxes in the training worlds (learning/train_detector.py)."""
_COCO_CLASSES = 80


class _Writer:
    """Collects sections, numbered from 0 after [net]."""

    def __init__(self, width: int, height: int, channels: int = 3) -> None:
        self._sections = [f"[net]\nwidth={width}\nheight={height}\nchannels={channels}\n"]

    @property
    def text(self) -> str:
        return "\n".join(self._sections)

    def add(self, kind: str, **options: object) -> None:
        self._sections.append(
            f"[{kind}]\n" + "".join(f"{name.rstrip('_')}={value}\n" for name, value in options.items())
        )

    def conv(self, filters: int, size: int, stride: int = 1) -> None:
        options = {"filters": filters, "size": size, "stride": stride, "pad": 1, "activation": "leaky"}
        self.add("convolutional", batch_normalize=1, **options)

    def residual(self, filters: int) -> None:
        """Half the width by 1x1, then 3x3, added to what was there."""
        self.conv(filters // 2, 1)
        self.conv(filters, 3)
        self.add("shortcut", from_=-3, activation="linear")

    def head(self, anchors: tuple[tuple[float, float], ...], mask: range, classes: int) -> None:
        filters = len(mask) * (5 + classes)
        self.add("convolutional", filters=filters, size=1, stride=1, pad=1, activation="linear")
        pairs = ", ".join(f"{width},{height}" for width, height in anchors)
        self.add("yolo", mask=",".join(map(str, mask)), anchors=pairs, classes=classes, num=len(anchors))

    def up_and_join(self, filters: int, back: int, layer: int) -> None:
        """From `back` layers ago, narrower and twice as large, beside an earlier layer's output."""
        self.add("route", layers=-back)
        self.conv(filters, 1)
        self.add("upsample", stride=2)
        self.add("route", layers=f"-1,{layer}")


def yolov3() -> str:
    """Darknet-53 and three heads (Redmon, Farhadi 2018)."""
    net = _Writer(416, 416)
    net.conv(32, 3)
    for filters, residuals in ((64, 1), (128, 2), (256, 8), (512, 8), (1024, 4)):
        net.conv(filters, 3, stride=2)
        for _ in range(residuals):
            net.residual(filters)
    for filters, mask, joined in ((512, range(6, 9), 61), (256, range(3, 6), 36), (128, range(3), None)):
        for _ in range(3):
            net.conv(filters, 1)
            net.conv(2 * filters, 3)
        net.head(_ANCHORS, mask, _COCO_CLASSES)
        if joined is not None:
            net.up_and_join(filters // 2, 4, joined)
    return net.text


def yolov3_tiny() -> str:
    """Seven convolutions with pooling between them, and two heads."""
    net = _Writer(416, 416)
    for filters in (16, 32, 64, 128, 256):
        net.conv(filters, 3)
        net.add("maxpool", size=2, stride=2)
    net.conv(512, 3)
    net.add("maxpool", size=2, stride=1)
    net.conv(1024, 3)
    net.conv(256, 1)
    net.conv(512, 3)
    net.head(_TINY_ANCHORS, range(3, 6), _COCO_CLASSES)
    net.up_and_join(128, 4, 8)
    net.conv(256, 3)
    net.head(_TINY_ANCHORS, range(3), _COCO_CLASSES)
    return net.text


def depth_yolo() -> str:
    """One class, depth images of 60x80 padded to 64x80 (encoding.py), heads at strides 8 (near people) and 4 (far)."""
    net = _Writer(80, 64)
    net.conv(16, 3, stride=2)
    net.conv(32, 3, stride=2)
    net.residual(32)
    net.conv(64, 3, stride=2)
    net.residual(64)
    net.residual(64)
    net.conv(32, 1)
    net.conv(64, 3)
    net.head(_DEPTH_ANCHORS, range(3, 6), 1)
    net.up_and_join(32, 4, 4)
    net.conv(32, 1)
    net.conv(64, 3)
    net.head(_DEPTH_ANCHORS, range(3), 1)
    return net.text


SHIPPED = {"yolov3": yolov3, "yolov3-tiny": yolov3_tiny, "depth-yolo": depth_yolo}
