"""Readers of recorded tracks: the HERMES corridor experiments and the ETH/UCY form.

They check and convert what a file says, to SI units; nothing is smoothed or resampled here (see `recordings`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64, Int64

from densecavoid.frames import require

HERMES_COLUMNS = ("id", "frame", "x", "y", "z")
HERMES_RATE_HZ = 16.0
TRACKS_COLUMNS = ("frame", "id", "x", "y")

MAX_FILE_BYTES = 64 * 2**20
"""Twenty times the largest public file; a larger one is no track file, and would fill the memory."""
MAX_DURATION_S = 6 * 3600.0
"""A frame further away than this from the others is a mistake, and would make hours of empty world."""
MAX_COORDINATE_M = 1000.0
MAX_EXACT_INTEGER = 2**53
"""Whole numbers beyond it are no longer told apart once read as float64."""
HEAD_HEIGHT_CM = (50.0, 250.0)


@dataclass(frozen=True, eq=False)
class Tracks:
    """Everybody's recorded places, sorted by person and then by time; no (person, time) stands twice."""

    source: str
    """The file, for messages."""
    person_id: Int64[np.ndarray, "rows"]
    """The file's own number of the person."""
    time_s: Float64[np.ndarray, "rows"]
    """Since the file's first frame."""
    pos_w: Float64[np.ndarray, "rows 2"]
    head_height_m: Float64[np.ndarray, "rows"] | None
    """None where the file does not tell."""
    period_s: float
    """Nominal time between two rows of one person."""


def read_hermes(path: Path) -> Tracks:
    """Reads a HERMES run: `id frame x y z` per line, 16 frames a second, cm; z is the height of the head.

    Raises:
        ValueError: naming file, line, column and what was expected.
        OSError: if the file cannot be read.
    """
    table, lines = _read_table(path, HERMES_COLUMNS)
    person_id, frame, x, y, z = table.T
    low, high = HEAD_HEIGHT_CM
    _refuse((z < low) | (z > high), path, lines, "z", z, f"the height of a head in cm, {low:g} to {high:g}")
    return _tracks(path, lines, person_id, frame, np.stack([x, y], axis=1) / 100, 1 / HERMES_RATE_HZ, 1, z / 100)


def read_tracks(path: Path, step_s: float = 0.4) -> Tracks:
    """Reads a file in the ETH/UCY form: `frame id x y` per line, metres, separated by blanks or tabs.

    Frame numbers may count video frames (0, 10, 20, ...): a step is the most common difference between frames that
    follow one another.

    Args:
        path: the file.
        step_s: time of one step, s; .4 is nominal (biwi_eth.txt is really .667, see the data's README).

    Raises:
        ValueError: naming file, line, column and what was expected.
        OSError: if the file cannot be read.
    """
    require(1e-3 <= step_s <= 10, "step_s", step_s, "from .001 to 10 s")
    table, lines = _read_table(path, TRACKS_COLUMNS)
    frame, person_id, x, y = table.T
    frames = np.unique(frame)
    if len(frames) < 2:
        raise ValueError(f"{path}: every row has frame {frames[0]:.17g}, expected at least two frames")
    differences, counts = np.unique(np.diff(frames), return_counts=True)
    frames_per_step = float(differences[np.argmax(counts)])
    return _tracks(path, lines, person_id, frame, np.stack([x, y], axis=1), step_s, frames_per_step, None)


def _tracks(
    path: Path,
    lines: Sequence[str],
    person_id: Float64[np.ndarray, "rows"],
    frame: Float64[np.ndarray, "rows"],
    pos_w: Float64[np.ndarray, "rows 2"],
    period_s: float,
    frames_per_period: float,
    head_height_m: Float64[np.ndarray, "rows"] | None,
) -> Tracks:
    """Checks what both forms share, and sorts."""
    for name, value in (("id", person_id), ("frame", frame)):
        _refuse(
            (value != np.round(value)) | (np.abs(value) > MAX_EXACT_INTEGER), path, lines, name, value, "an integer"
        )
    _refuse(frame < 0, path, lines, "frame", frame, "0 or more")
    for axis, name in enumerate("xy"):
        value = pos_w[:, axis]
        _refuse(
            np.abs(value) > MAX_COORDINATE_M, path, lines, f"{name} in m", value, f"within {MAX_COORDINATE_M:g} m of 0"
        )
    max_frames = MAX_DURATION_S / period_s * frames_per_period
    if np.ptp(frame) > max_frames:
        middle = np.median(frame)
        farthest = np.abs(frame - middle) == np.abs(frame - middle).max()
        expected = f"frames over {MAX_DURATION_S / 3600:g} h at most (half of them lie around {middle:.0f})"
        _refuse(farthest, path, lines, "frame", frame, expected)

    order = np.lexsort((frame, person_id))
    person_id, frame = person_id[order], frame[order]
    twice = np.flatnonzero((np.diff(person_id) == 0) & (np.diff(frame) == 0))
    if len(twice):
        first, second = (_line_number(lines, int(order[twice[0] + k])) for k in (0, 1))
        raise ValueError(
            f"{path}:{second}: id {person_id[twice[0]]:.0f} at frame {frame[twice[0]]:.0f} is in line {first} already, "
            "expected each person once in a frame"
        )
    return Tracks(
        source=str(path),
        person_id=person_id.astype(np.int64),
        time_s=(frame - frame.min()) * (period_s / frames_per_period),
        pos_w=pos_w[order],
        head_height_m=None if head_height_m is None else head_height_m[order],
        period_s=period_s,
    )


def _read_table(path: Path, columns: Sequence[str]) -> tuple[Float64[np.ndarray, "rows columns"], list[str]]:
    """The finite numbers of a text table, and its lines. Blank lines and what follows a # are passed over."""
    lines = _read_text(path).split("\n")
    if not any(_fields(line) for line in lines):
        raise ValueError(f"{path}: no rows, expected lines of `{' '.join(columns)}`")
    try:
        table = np.loadtxt(lines, dtype=np.float64, comments="#", ndmin=2)
    except ValueError as error:
        _explain(path, lines, columns)
        raise ValueError(f"{path}: {error}") from error
    if table.shape[1] != len(columns):
        _explain(path, lines, columns)
    for name, value in zip(columns, table.T, strict=True):
        _refuse(~np.isfinite(value), path, lines, name, value, "a finite number")
    return table, lines


def _read_text(path: Path) -> str:
    size = path.stat().st_size
    if size > MAX_FILE_BYTES:
        raise ValueError(f"{path}: {size} bytes, expected a track file of at most {MAX_FILE_BYTES}")
    content = path.read_bytes()
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ValueError(f"{path}:{line}: byte 0x{content[error.start]:02x}, expected a text file") from None
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise ValueError(f"{path}:{line}: byte 0x00, expected a text file")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _explain(path: Path, lines: Sequence[str], columns: Sequence[str]) -> None:
    """Raises ValueError for the first line that is not one number a column. Slow: only for files known to be wrong."""
    for number, line in enumerate(lines, start=1):
        fields = _fields(line)
        if fields and len(fields) != len(columns):
            raise ValueError(f"{path}:{number}: {len(fields)} columns, expected {len(columns)}: `{' '.join(columns)}`")
        for name, field in zip(columns, fields, strict=False):
            try:
                float(field)
            except ValueError:
                shown = field if len(field) <= 40 else field[:40] + "..."
                raise ValueError(f"{path}:{number}: {name} is {shown!r}, expected a number") from None


def _fields(line: str) -> list[str]:
    return line.split("#", 1)[0].split()


def _refuse(
    bad: Bool[np.ndarray, "rows"],
    path: Path,
    lines: Sequence[str],
    column: str,
    value: Float64[np.ndarray, "rows"],
    expected: str,
) -> None:
    """Raises ValueError for the first bad row, if there is one."""
    if bad.any():
        row = int(np.argmax(bad))
        raise ValueError(f"{path}:{_line_number(lines, row)}: {column} is {value[row]:.12g}, expected {expected}")


def _line_number(lines: Sequence[str], row: int) -> int:
    """The line (from 1) that holds a row of the table (from 0)."""
    return [number for number, line in enumerate(lines, start=1) if _fields(line)][row]
