"""Recorded crowds in the form that the simulator replays: places and velocities of everybody present, step by step.

Also says where the recordings lie and how wide their corridors are. It builds no world and moves no robot.
"""

from __future__ import annotations

import functools
import itertools
import json
import os
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from densecavoid.frames import choose, require
from densecavoid.scenarios.track_files import Tracks, read_hermes, read_tracks
from densecavoid.sim.crowds.recording import Recording
from densecavoid.sim.people import sample_bodies

# scipy's parts are imported where they are used: together they take half a second, which only recordings need.

DATA_VARIABLE = "DENSECAVOID_DATA"
SWAY_CUTOFF_HZ = 0.55
"""Below the stride frequency of slow walkers (.65 Hz at .5 m/s, half the step frequency: the head sways to the side
once a stride), above what turning needs (.2 Hz on a circle of 1 m at 1.3 m/s)."""
SWAY_FILTER_ORDER = 3
SWAY_PAD_S = 2.0
MIN_BRIDGED_GAP_S = 0.5
BRIDGED_GAP_PERIODS = 3
"""A person unseen for longer than the larger of the two has left: what follows is another visit."""
MAX_ROWS = 20_000_000

_BODY_SEED = 20_090_512
_CORRIDOR_WIDTH_M = (0.5, 20.0)


@functools.lru_cache(maxsize=32)
def load_recording(path: Path, form: str, dt_s: float = 0.05, step_s: float = 0.4) -> Recording:
    """Reads and resamples a recording; the same arguments give the same object again.

    Args:
        path: the file.
        form: "hermes" (heads at 16 Hz: the gait sway is smoothed away) or "tracks" (ETH/UCY: interpolated).
        dt_s: time step of the result, s.
        step_s: time of one step of an ETH/UCY file, s.

    Raises:
        ValueError: if the file is malformed, naming file, line and column.
        OSError: if the file cannot be read.
    """
    if choose("form of recording", form, ("hermes", "tracks")) == "hermes":
        return resample(read_hermes(path), dt_s=dt_s, sway_cutoff_hz=SWAY_CUTOFF_HZ)
    return resample(read_tracks(path, step_s), dt_s=dt_s)


def resample(tracks: Tracks, *, dt_s: float = 0.05, sway_cutoff_hz: float | None = None) -> Recording:
    """Everybody's place and velocity at the steps 0, dt_s, 2 dt_s, ...; velocity is the derivative of the place.

    Without a cutoff the curve passes through every recorded place and, along each axis, never beyond its two
    neighbours (monotone cubic: Fritsch and Butland 1984). With one, the tracks are smoothed first (`remove_sway`) and
    joined by a cubic spline. Nobody is extrapolated. Visits of a single row have no velocity and are left out.

    Args:
        tracks: the recorded places.
        dt_s: time step, s.
        sway_cutoff_hz: None, or the frequency above which movement is taken for gait sway.

    Raises:
        ValueError: if nobody is left, or the result would not fit in memory.
    """
    require(1e-3 <= dt_s <= 1, "dt_s", dt_s, "from .001 to 1 s")
    visits = _visits(tracks)
    tolerance = 1e-6  # of a step: recorded times that fall on a step are that step
    first = [int(np.ceil(tracks.time_s[rows.start] / dt_s - tolerance)) for rows in visits]
    last = [int(np.floor(tracks.time_s[rows.stop - 1] / dt_s + tolerance)) for rows in visits]
    kept = [k for k in range(len(visits)) if last[k] >= first[k]]
    num_rows = sum(last[k] - first[k] + 1 for k in kept)
    if not kept:
        raise ValueError(f"{tracks.source}: nobody is seen twice in a row, expected tracks of at least two rows")
    if num_rows > MAX_ROWS:
        raise ValueError(f"{tracks.source}: {num_rows} states at dt_s = {dt_s:g} s, expected at most {MAX_ROWS}")

    step = np.concatenate([np.arange(first[k], last[k] + 1) for k in kept])
    person = np.repeat(np.arange(len(kept)), [last[k] - first[k] + 1 for k in kept])
    state = np.concatenate(
        [_states(tracks, visits[k], np.arange(first[k], last[k] + 1) * dt_s, sway_cutoff_hz) for k in kept]
    )
    order = np.argsort(step, kind="stable")  # stable: within a step, in the order of persons as before
    num_steps = int(step.max()) + 1
    frame_start = np.zeros(num_steps + 1, np.int32)
    np.cumsum(np.bincount(step, minlength=num_steps), out=frame_start[1:])

    rng = np.random.default_rng(_BODY_SEED)
    radius_m, height_m = sample_bodies(rng, len(kept))  # what the recording does not tell
    if tracks.head_height_m is not None:
        height_m = np.array([np.median(tracks.head_height_m[visits[k]]) for k in kept])
    return Recording(
        dt_s=dt_s,
        frame_start=frame_start,
        state_w=state[order].astype(np.float32),
        person=person[order].astype(np.int32),
        height_m=height_m.astype(np.float32),
        radius_m=radius_m.astype(np.float32),
        file_id=np.array([tracks.person_id[visits[k].start] for k in kept]),
    )


def remove_sway(
    pos: Float64[np.ndarray, "samples 2"], rate_hz: float, cutoff_hz: float = SWAY_CUTOFF_HZ
) -> Float64[np.ndarray, "samples 2"]:
    """The way of a person's body, from that of the swaying head.

    A Butterworth low pass run forwards and backwards, so that nothing is delayed. What is filtered is the deviation
    from the line between the two ends, continued beyond them by point reflection: straight walks at constant speed stay
    as they are, tracks keep their length, and both ends stay within a centimetre of where they were recorded. The price
    is that part of the sway remains in the first and last second and a half.

    Args:
        pos: places at equal times, m.
        rate_hz: samples a second.
        cutoff_hz: where the amplitude falls to a half.
    """
    num = len(pos)
    line = pos[0] + (pos[-1] - pos[0]) * np.linspace(0, 1, num)[:, None]
    from scipy import signal

    low_pass = signal.butter(SWAY_FILTER_ORDER, cutoff_hz, fs=rate_hz, output="sos")
    padding = min(round(SWAY_PAD_S * rate_hz), num - 1)
    return line + signal.sosfiltfilt(low_pass, pos - line, axis=0, padtype="odd", padlen=padding)


def resolve_data(data: Path | None = None) -> Path:
    """The folder of recordings: the argument, else the environment variable DENSECAVOID_DATA.

    Raises:
        ValueError: if neither is given.
        NotADirectoryError: if there is no such folder.
    """
    given = "--data"
    if data is None:
        value = os.environ.get(DATA_VARIABLE, "")
        if not value:
            raise ValueError(f"this scenario replays recordings: give their folder by --data PATH or {DATA_VARIABLE}")
        given, data = DATA_VARIABLE, Path(value)
    if not data.is_dir():
        raise NotADirectoryError(f"{given} is {str(data)!r}, expected a folder of recordings (with hermes/ in it)")
    return data


def hermes_runs(data: Path) -> tuple[str, ...]:
    """The names of the runs in a folder of recordings."""
    return tuple(sorted(path.stem for path in _hermes_folder(data).glob("*.txt")))


def hermes_path(data: Path, run: str) -> Path:
    """The file of a HERMES run.

    Raises:
        ValueError: if there is no such run, listing those there are.
        FileNotFoundError: if there is no run at all.
    """
    folder, runs = _hermes_folder(data), hermes_runs(data)
    if not runs:
        raise FileNotFoundError(f"no HERMES run (*.txt) in {folder}")
    return folder / f"{choose(f'HERMES run in {folder}:', run, runs)}.txt"


def hermes_width_m(data: Path, run: str) -> float:
    """The width of a run's corridor: from run_table.json, or from the run's name where there is no table.

    Names are `bo-360-...` (two-way: the first number is the corridor's width in cm) and `uo-080-240-...` (one-way: the
    first is the entrance's, the second the corridor's).

    Raises:
        ValueError: if the table or the name does not tell, naming file and key.
    """
    path = _hermes_folder(data) / "run_table.json"
    if not path.is_file():
        match = re.fullmatch(r"(?:bo[at]?-(\d{3})|uo-\d{3}-(\d{3}))-.*", run)
        if match is None:
            raise ValueError(f"no {path}, and {run!r} does not tell a width as bo-360-050-050 or uo-080-240-240 do")
        return int(match[1] or match[2]) / 100
    try:
        table = json.loads(path.read_bytes())
    except ValueError as error:  # malformed JSON, or bytes that are no text
        raise ValueError(f"{path}: {error}, expected a JSON list of runs") from None
    if not isinstance(table, list) or not all(isinstance(entry, dict) for entry in table):
        raise ValueError(f"{path}: expected a JSON list of objects, one a run")
    entry = next((entry for entry in table if entry.get("run") == run), None)
    if entry is None:
        raise ValueError(f'{path}: no object with "run": {run!r}')
    width = entry.get("width")
    low, high = _CORRIDOR_WIDTH_M
    if not isinstance(width, int | float) or isinstance(width, bool) or not low <= width <= high:
        raise ValueError(f'{path}: run {run!r}: "width" is {width!r}, expected metres from {low:g} to {high:g}')
    return float(width)


def _hermes_folder(data: Path) -> Path:
    """`data` may be the folder of all recordings, or that of HERMES itself."""
    return data / "hermes" if (data / "hermes").is_dir() else data


def _visits(tracks: Tracks) -> list[slice]:
    """The rows of each unbroken stay of a person, two rows at least."""
    max_gap_s = max(MIN_BRIDGED_GAP_S, BRIDGED_GAP_PERIODS * tracks.period_s) * (1 + 1e-9)
    breaks = (np.diff(tracks.person_id) != 0) | (np.diff(tracks.time_s) > max_gap_s)
    edges = [0, *(np.flatnonzero(breaks) + 1).tolist(), len(tracks.person_id)]
    return [slice(a, b) for a, b in itertools.pairwise(edges) if b - a >= 2]


def _states(
    tracks: Tracks, rows: slice, query_s: Float64[np.ndarray, "steps"], sway_cutoff_hz: float | None
) -> Float64[np.ndarray, "steps 4"]:
    """Place and velocity of one visit at the times asked for."""
    from scipy import interpolate

    time_s, pos = tracks.time_s[rows], tracks.pos_w[rows]
    query_s = np.clip(query_s, time_s[0], time_s[-1])
    if sway_cutoff_hz is None:
        curve = interpolate.PchipInterpolator(time_s, pos)
    else:
        # The filter wants equal times: short gaps, already known to be no longer than _visits allows, are bridged.
        num = round((time_s[-1] - time_s[0]) / tracks.period_s) + 1
        even_s = np.linspace(time_s[0], time_s[-1], num)
        even = np.stack([np.interp(even_s, time_s, pos[:, axis]) for axis in (0, 1)], axis=1)
        curve = interpolate.CubicSpline(even_s, remove_sway(even, 1 / tracks.period_s, sway_cutoff_hz))
    return np.concatenate([curve(query_s), curve(query_s, 1)], axis=1)
