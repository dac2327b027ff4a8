"""Where a film's pictures go: a GIF or an MP4 file. Knows files and frame rates, not what the pictures show."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, cast, runtime_checkable

import imageio_ffmpeg
import numpy as np
from PIL import Image

from densecavoid.frames import choose
from densecavoid.viz import theme

SUFFIXES = (".gif", ".mp4")
GIF_MAX_FRAMES = 320
"""Of a longer film every other picture is dropped: it still plays in real time, and stays of a size to be shown."""


@runtime_checkable
class Sink(Protocol):
    """Takes pictures one after the other."""

    def add(self, picture: Image.Image) -> None:
        """The next picture."""
        ...

    def close(self, hold_s: float) -> None:
        """Writes the file; the last picture stays for `hold_s`."""
        ...

    def abandon(self) -> None:
        """Leaves no file behind."""
        ...


def open_sink(path: Path, size_px: tuple[int, int], frame_s: float) -> Sink:
    """A sink for the kind of file that the name asks for; `frame_s` is the time from picture to picture."""
    path.parent.mkdir(parents=True, exist_ok=True)
    kind = choose("ending of a film's name", path.suffix.lower(), SUFFIXES)
    return GifSink(path, frame_s) if kind == ".gif" else Mp4Sink(path, size_px, frame_s)


class GifSink:
    """Collects pictures of one shared palette and writes what changes between them."""

    def __init__(self, path: Path, frame_s: float) -> None:
        self._path, self._frame_s = path, frame_s
        self._frames: list[Image.Image] = []
        self._stride, self._count = 1, 0
        self._last: Image.Image | None = None

    def add(self, picture: Image.Image) -> None:
        self._last = picture.quantize(palette=theme.palette_image(), dither=Image.Dither.NONE)
        if self._count % self._stride == 0:
            self._frames.append(self._last)
        self._count += 1
        if len(self._frames) > GIF_MAX_FRAMES:
            self._frames = self._frames[::2]
            self._stride *= 2

    def close(self, hold_s: float) -> None:
        if self._last is None:
            return
        frames = self._frames if self._frames[-1] is self._last else [*self._frames, self._last]
        frame_ms = round(1000 * self._frame_s * self._stride)
        durations = [frame_ms] * (len(frames) - 1) + [max(frame_ms, round(1000 * hold_s))]
        frames[0].save(
            self._path, save_all=True, append_images=frames[1:], duration=durations, loop=0, optimize=True, disposal=1
        )
        self._frames = []

    def abandon(self) -> None:
        self._frames = []


class Mp4Sink:
    """Hands pictures to ffmpeg as they come."""

    def __init__(self, path: Path, size_px: tuple[int, int], frame_s: float) -> None:
        self._path, self._frame_s = path, frame_s
        self._last: bytes | None = None
        # The command line knows fractional rates, which the function's annotation does not.
        rate = cast(int, 1 / frame_s)
        self._writer = imageio_ffmpeg.write_frames(
            str(path), size_px, fps=rate, quality=8, macro_block_size=2, ffmpeg_log_level="error"
        )
        self._writer.send(None)

    def add(self, picture: Image.Image) -> None:
        self._last = np.asarray(picture.convert("RGB")).tobytes()
        self._writer.send(self._last)

    def close(self, hold_s: float) -> None:
        if self._last is not None:
            for _ in range(round(hold_s / self._frame_s)):
                self._writer.send(self._last)
        self._writer.close()

    def abandon(self) -> None:
        self._writer.close()
        self._path.unlink(missing_ok=True)
