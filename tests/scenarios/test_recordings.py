"""Recorded crowds: what the readers accept and refuse, what resampling keeps, and the real files."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest

from densecavoid.scenarios import recordings, track_files
from densecavoid.scenarios.recordings import load_recording, remove_sway, resample
from densecavoid.scenarios.track_files import read_hermes, read_tracks


def write(folder: Path, content: str | bytes, name: str = "tracks.txt") -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def hermes_lines(frames: range, person: int = 1, x_cm: float = 100.0, step_cm: float = 8.0) -> str:
    """A walk along +y at step_cm per frame (8 cm at 16 Hz is 1.28 m/s)."""
    return "".join(f"{person} {frame} {x_cm} {-600 + step_cm * (frame - frames.start)} 175.5\n" for frame in frames)


# Readers: hand-made files, hand values.


def test_hermes_reader_gives_metres_and_seconds(tmp_path: Path) -> None:
    tracks = read_hermes(write(tmp_path, "7 24 50 -200 170.5\n3 8 100 -600 180\n3 16 120 -580 180\n"))
    np.testing.assert_array_equal(tracks.person_id, [3, 3, 7])
    np.testing.assert_allclose(tracks.time_s, [0.0, 0.5, 1.0])  # 8 frames of 1/16 s each
    np.testing.assert_allclose(tracks.pos_w, [[1, -6], [1.2, -5.8], [0.5, -2]])
    assert tracks.head_height_m is not None
    np.testing.assert_allclose(tracks.head_height_m, [1.8, 1.8, 1.705])


@pytest.mark.parametrize("separator", [" ", "\t", "   "])
def test_tracks_reader_finds_the_frame_step(tmp_path: Path, separator: str) -> None:
    rows = [(0, 1, 2.0, 3.0), (10, 1, 2.5, 3.0), (20, 1, 3.0, 3.0), (20, 2, 9.0, 9.0), (60, 2, 8.0, 9.0)]
    text = "# frame id x y\n\n" + "".join(separator.join(str(float(v)) for v in row) + "\r\n" for row in rows)
    tracks = read_tracks(write(tmp_path, text))
    np.testing.assert_allclose(tracks.time_s, [0, 0.4, 0.8, 0.8, 2.4])  # ten frame numbers are .4 s
    assert tracks.head_height_m is None
    slow = read_tracks(write(tmp_path, text), step_s=0.667)
    np.testing.assert_allclose(slow.time_s, np.array([0, 1, 2, 2, 6]) * 0.667)


GOOD = "1 0 100 -600 175\n"
MALFORMED_HERMES = {
    "a missing column": (GOOD + "1 1 100 -592\n", ":2: 4 columns, expected 5: `id frame x y z`"),
    "columns missing everywhere": ("\n1 1 100 -592\n1 2 100 -590\n", ":2: 4 columns, expected 5: `id frame x y z`"),
    "a word": (GOOD + "\n1 1 abc -592 175\n", ":3: x is 'abc', expected a number"),
    "an infinite place": (GOOD + "1 1 inf -592 175\n", ":2: x is inf, expected a finite number"),
    "a place that is not a number": (GOOD + "# note\n1 1 100 nan 175\n", ":3: y is nan, expected a finite number"),
    "a negative frame": (GOOD + "1 -1 100 -592 175\n", ":2: frame is -1, expected 0 or more"),
    "half a frame": (GOOD + "1 1.5 100 -592 175\n", ":2: frame is 1.5, expected an integer"),
    "an id too long to tell apart": (GOOD + "1e17 1 100 -592 175\n", ":2: id is 1e+17, expected an integer"),
    "metres instead of centimetres": ("1 0 1.00 -6.00 1.75\n", ":1: z is 1.75, expected the height of a head in cm"),
    "a place on another continent": (GOOD + "1 1 1e9 -592 175\n", ":2: x in m is 10000000, expected within 1000 m"),
    "the same person twice in a frame": (
        GOOD + "2 0 0 0 175\n1 0 100 -592 175\n",
        ":3: id 1 at frame 0 is in line 1 already, expected each person once in a frame",
    ),
    "a frame far away": (
        GOOD + "1 1 100 -592 175\n1 90000000 0 0 175\n",
        ":3: frame is 90000000, expected frames over",
    ),
    "no rows": ("\n# id frame x y z\n  \n", ": no rows, expected lines of `id frame x y z`"),
    "an empty file": ("", ": no rows"),
    "binary content": (b"\x89PNG\r\n\x1a\n\x00\x00", ":1: byte 0x89, expected a text file"),
    "zero bytes": (b"1 0 100 -600 175\n\x00\x00\x00", ":2: byte 0x00, expected a text file"),
}


@pytest.mark.parametrize("content, message", MALFORMED_HERMES.values(), ids=MALFORMED_HERMES.keys())
def test_malformed_hermes_file_is_refused_with_file_and_line(
    tmp_path: Path, content: str | bytes, message: str
) -> None:
    path = write(tmp_path, content)
    with pytest.raises(ValueError) as refused:
        read_hermes(path)
    assert str(refused.value).startswith(f"{path}{message}")


MALFORMED_TRACKS = {
    "five columns": ("0 1 2 3\n10 1 2 3 4\n", ":2: 5 columns, expected 4: `frame id x y`"),
    "commas": ("0,1,2,3\n", ":1: 1 columns, expected 4: `frame id x y`"),
    "one frame only": ("5 1 2 3\n5 2 2 3\n", ": every row has frame 5, expected at least two frames"),
    "a half id": ("0 1 2 3\n10 1.5 2 3\n", ":2: id is 1.5, expected an integer"),
}


@pytest.mark.parametrize("content, message", MALFORMED_TRACKS.values(), ids=MALFORMED_TRACKS.keys())
def test_malformed_tracks_file_is_refused_with_file_and_line(tmp_path: Path, content: str, message: str) -> None:
    path = write(tmp_path, content)
    with pytest.raises(ValueError) as refused:
        read_tracks(path)
    assert str(refused.value).startswith(f"{path}{message}")


def test_file_of_absurd_size_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "huge.txt"
    with path.open("wb") as file:
        file.truncate(track_files.MAX_FILE_BYTES + 1)
    with pytest.raises(ValueError, match=r"huge\.txt: 67108865 bytes, expected"):
        read_tracks(path)


@pytest.mark.parametrize("step_s", [0.0, -0.4, float("nan"), 100.0])
def test_impossible_step_is_refused(tmp_path: Path, step_s: float) -> None:
    with pytest.raises(ValueError, match="step_s is"):
        read_tracks(write(tmp_path, "0 1 0 0\n1 1 0 0\n"), step_s)


def test_a_hundred_thousand_lines_are_read_at_once(tmp_path: Path) -> None:
    path = write(tmp_path, "".join(f"{k // 500} {k % 500} {k % 300}.123 {k % 600}.456 170.1\n" for k in range(100_000)))
    start = time.perf_counter()
    assert len(read_hermes(path).time_s) == 100_000
    assert time.perf_counter() - start < 1.5  # .12 s on one core; slack for a busy machine


# Resampling.


@pytest.mark.parametrize("form", ["hermes", "tracks"])
def test_constant_velocity_is_replayed_exactly(tmp_path: Path, form: str) -> None:
    if form == "hermes":
        path = write(tmp_path, hermes_lines(range(40, 121)))  # 5 s at 1.28 m/s from (1, -6)
        start, velocity, duration_s = np.array([1, -6]), np.array([0, 1.28]), 5.0
    else:
        path = write(tmp_path, "".join(f"{10 * k} 4 {2 + 0.4 * k} {5 - 0.2 * k}\n" for k in range(11)))
        start, velocity, duration_s = np.array([2, 5]), np.array([1.0, -0.5]), 4.0
    recording = load_recording(path, form)
    assert recording.duration_s == pytest.approx(duration_s)
    assert recording.num_people == recording.max_people == 1
    for step in range(recording.num_steps):
        person, state = recording.at(step)
        assert person.tolist() == [0]
        np.testing.assert_allclose(state[0, :2], start + velocity * step * 0.05, atol=2e-6)
        np.testing.assert_allclose(state[0, 2:], velocity, atol=2e-6)


def test_velocity_is_the_derivative_of_the_place(tmp_path: Path) -> None:
    angle = np.linspace(0, 2, 60)
    rows = [f"1 {k} {300 * np.cos(a)} {300 * np.sin(a)} 170\n" for k, a in enumerate(angle)]
    state = load_recording(write(tmp_path, "".join(rows)), "hermes", dt_s=0.01).state_w.astype(float)
    np.testing.assert_allclose((state[2:, :2] - state[:-2, :2]) / 0.02, state[1:-1, 2:], atol=2e-3)


def test_interpolation_passes_through_the_rows_and_never_beyond_them(tmp_path: Path) -> None:
    x = np.array([0, 0, 0, 1.0, 1.0, 3.0, 2.0])  # stands, starts, stops, turns back
    path = write(tmp_path, "".join(f"{k} 1 {value} 0\n" for k, value in enumerate(x)))
    state = load_recording(path, "tracks").state_w
    np.testing.assert_allclose(state[::8, 0], x, atol=1e-6)  # .4 s is 8 steps of .05 s
    for k in range(len(x) - 1):
        low, high = sorted(x[k : k + 2])
        between = state[8 * k : 8 * k + 9, 0]
        assert between.min() >= low - 1e-6 and between.max() <= high + 1e-6


def test_rows_are_grouped_by_step_and_sorted_by_person(tmp_path: Path) -> None:
    path = write(tmp_path, hermes_lines(range(16, 48), 9, 200) + hermes_lines(range(0, 32), 4, 100))
    recording = load_recording(path, "hermes")
    assert recording.file_id.tolist() == [4, 9]
    # id 4 from 0 to 31/16 s, id 9 from 1 to 47/16 s: steps 0..38 and 20..58
    counts = [(step <= 38) + (20 <= step <= 58) for step in range(59)]
    np.testing.assert_array_equal(np.diff(recording.frame_start), counts)
    assert recording.max_people == 2
    for step in range(recording.num_steps):
        person, state = recording.at(step)
        assert person.tolist() == [p for p, there in ((0, step <= 38), (1, step >= 20)) if there]
        np.testing.assert_allclose(state[:, 0], [(1.0, 2.0)[p] for p in person], atol=1e-6)
    dtypes = [a.dtype for a in (recording.frame_start, recording.person, recording.state_w, recording.radius_m)]
    assert dtypes == [np.int32, np.int32, np.float32, np.float32]


def test_a_short_gap_is_bridged_and_a_long_one_is_another_visit(tmp_path: Path) -> None:
    bridged = "".join(f"1 {k} {10 * k} 0 170\n" for k in [*range(16), *range(23, 40)])  # 8 frames apart: .5 s
    recording = load_recording(write(tmp_path, bridged, "bridged.txt"), "hermes")
    assert recording.num_people == 1
    np.testing.assert_allclose(recording.state_w[:, 2], 1.6, atol=1e-5)
    left = "".join(f"1 {k} {10 * k} 0 170\n" for k in [*range(16), *range(24, 40)])
    recording = load_recording(write(tmp_path, left, "left.txt"), "hermes")
    assert recording.file_id.tolist() == [1, 1]
    assert len(recording.at(24)[0]) == 0  # 1.2 s: gone at .94 s, back at 1.5 s


def test_a_person_seen_once_is_left_out(tmp_path: Path) -> None:
    recording = load_recording(write(tmp_path, "0 1 0 0\n1 1 1 0\n1 2 5 5\n"), "tracks")
    assert recording.file_id.tolist() == [1]
    with pytest.raises(ValueError, match="nobody is seen twice in a row"):
        load_recording(write(tmp_path, "0 1 0 0\n1 2 1 0\n", "once.txt"), "tracks")


def test_result_too_large_for_memory_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recordings, "MAX_ROWS", 60)
    tracks = read_hermes(write(tmp_path, hermes_lines(range(0, 81))))
    with pytest.raises(ValueError, match=r"tracks\.txt: 101 states at dt_s = 0\.05 s, expected at most 60"):
        resample(tracks)
    assert resample(tracks, dt_s=0.1).num_steps == 51


@pytest.mark.parametrize("dt_s", [0.0, -0.05, float("nan"), 5.0])
def test_impossible_time_step_is_refused(tmp_path: Path, dt_s: float) -> None:
    with pytest.raises(ValueError, match="dt_s is"):
        resample(read_hermes(write(tmp_path, hermes_lines(range(8)))), dt_s=dt_s)


def test_bodies_are_adults_and_the_same_every_time(tmp_path: Path) -> None:
    path = write(tmp_path, "".join(f"{frame} {person} 0 0\n" for person in range(2000) for frame in (0, 1)))
    one, two = resample(read_tracks(path)), resample(read_tracks(path))
    np.testing.assert_array_equal(one.radius_m, two.radius_m)
    np.testing.assert_array_equal(one.height_m, two.height_m)
    assert one.radius_m.mean() == pytest.approx(0.255, abs=0.003)
    assert one.radius_m.std() == pytest.approx(0.035, rel=0.15)
    assert one.radius_m.min() > 0.18 and one.radius_m.max() <= np.float32(0.33)
    assert one.height_m.mean() == pytest.approx(1.71, abs=0.01)
    tall = load_recording(write(tmp_path, hermes_lines(range(8)), "tall.txt"), "hermes")
    assert tall.height_m[0] == pytest.approx(1.755)


def test_loading_again_gives_the_cached_recording(tmp_path: Path) -> None:
    path = write(tmp_path, hermes_lines(range(8)))
    assert load_recording(path, "hermes") is load_recording(path, "hermes")
    with pytest.raises(ValueError, match="unknown form of recording 'csv', expected one of: hermes, tracks"):
        load_recording(path, "csv")


# Gait sway. In the first and last second and a half part of it stays.

T_S = np.arange(0, 10, 1 / 16)
INNER = slice(24, -24)
WAYS = {
    "straight": np.stack([0 * T_S, 1.3 * T_S], axis=1),
    "circle of 1.5 m": 1.5 * np.stack([np.cos(1.3 / 1.5 * T_S), np.sin(1.3 / 1.5 * T_S)], axis=1),
    "slalom of 1 m in 6 s": np.stack([0.5 * np.sin(2 * np.pi * T_S / 6), 1.3 * T_S], axis=1),
    "stops and goes on": np.stack([0 * T_S, 0.65 * T_S + 0.65 * 8 / (2 * np.pi) * np.sin(2 * np.pi * T_S / 8)], axis=1),
}


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS.keys())
def test_ways_are_kept_within_two_centimetres(way: np.ndarray) -> None:
    error = np.linalg.norm(remove_sway(way, 16.0) - way, axis=1)
    assert error[INNER].max() < 0.02
    assert error.max() < 0.04


@pytest.mark.parametrize("frequency_hz", [0.9, 1.8])
@pytest.mark.parametrize("phase", [0.0, 0.7, 1.6, 2.5])
def test_sway_of_four_centimetres_falls_below_one(frequency_hz: float, phase: float) -> None:
    sway = 0.04 * np.sin(2 * np.pi * frequency_hz * T_S + phase)
    way = WAYS["circle of 1.5 m"]
    left = remove_sway(way + sway[:, None] * [1, 0], 16.0) - way
    assert np.abs(sway[INNER]).max() > 0.038
    assert np.linalg.norm(left[INNER], axis=1).max() < 0.01


def test_tracks_keep_their_ends_and_are_not_delayed() -> None:
    way = WAYS["stops and goes on"] + 0.03 * np.sin(2 * np.pi * 1.8 * T_S + 1)[:, None]
    smooth = remove_sway(way, 16.0)
    np.testing.assert_allclose(smooth[[0, -1]], way[[0, -1]], atol=0.01)
    np.testing.assert_allclose(remove_sway(way[::-1], 16.0)[::-1], smooth, atol=0.01)  # a sample's delay is .1 m


@pytest.mark.parametrize("num", [2, 3, 5, 20])
def test_short_tracks_are_smoothed_too(num: int) -> None:
    way = WAYS["straight"][:num]
    np.testing.assert_allclose(remove_sway(way, 16.0), way, atol=1e-9)


# Where the data lie.


def test_data_folder_comes_from_argument_then_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DENSECAVOID_DATA", str(tmp_path))
    assert recordings.resolve_data() == tmp_path
    (tmp_path / "other").mkdir()
    assert recordings.resolve_data(tmp_path / "other") == tmp_path / "other"
    with pytest.raises(NotADirectoryError, match=r"--data is .*missing"):
        recordings.resolve_data(tmp_path / "missing")
    monkeypatch.setenv("DENSECAVOID_DATA", str(tmp_path / "gone"))
    with pytest.raises(NotADirectoryError, match=r"DENSECAVOID_DATA is .*gone"):
        recordings.resolve_data()
    monkeypatch.delenv("DENSECAVOID_DATA")
    with pytest.raises(ValueError, match="--data PATH or DENSECAVOID_DATA"):
        recordings.resolve_data()


@pytest.mark.parametrize("layout", ["hermes", "."])
def test_unknown_run_lists_those_there_are(tmp_path: Path, layout: str) -> None:
    folder = tmp_path / layout
    folder.mkdir(exist_ok=True)
    with pytest.raises(FileNotFoundError, match="no HERMES run"):
        recordings.hermes_path(tmp_path, "bo-1")
    write(folder, "", "bo-1.txt")
    write(folder, "", "uo-2.txt")
    assert recordings.hermes_path(tmp_path, "bo-1") == folder / "bo-1.txt"
    for unknown in ("bo-3", "../hermes/bo-1", ""):
        with pytest.raises(ValueError, match="expected one of: bo-1, uo-2"):
            recordings.hermes_path(tmp_path, unknown)


def test_width_comes_from_the_table_and_else_from_the_name(tmp_path: Path) -> None:
    for run, width_m in {"bo-360-050-050": 3.6, "boa-300-065-105": 3.0, "bot-300-065-065": 3.0}.items():
        assert recordings.hermes_width_m(tmp_path, run) == width_m
    assert recordings.hermes_width_m(tmp_path, "uo-080-240-300") == 2.4
    with pytest.raises(ValueError, match=r"run_table\.json, and 'my-crowd' does not tell a width"):
        recordings.hermes_width_m(tmp_path, "my-crowd")
    write(tmp_path, json.dumps([{"run": "my-crowd", "width": 2.5}]), "run_table.json")
    assert recordings.hermes_width_m(tmp_path, "my-crowd") == 2.5


@pytest.mark.parametrize(
    "content, message",
    [
        ("[{", "expected a JSON list of runs"),
        (b"\xff\xfe\x00", "expected a JSON list of runs"),
        ('{"run": "bo-1"}', "expected a JSON list of objects"),
        ("[1]", "expected a JSON list of objects"),
        ("[]", "no object with \"run\": 'bo-1'"),
        ('[{"run": "bo-1"}]', "run 'bo-1': \"width\" is None, expected metres from 0.5 to 20"),
        ('[{"run": "bo-1", "width": "3"}]', "run 'bo-1': \"width\" is '3', expected metres"),
        ('[{"run": "bo-1", "width": 360}]', "run 'bo-1': \"width\" is 360, expected metres"),
        ('[{"run": "bo-1", "width": true}]', "run 'bo-1': \"width\" is True, expected metres"),
        ('[{"run": "bo-1", "width": NaN}]', "run 'bo-1': \"width\" is nan, expected metres"),
    ],
)
def test_malformed_table_is_refused_with_file_and_key(tmp_path: Path, content: str | bytes, message: str) -> None:
    path = write(tmp_path, content, "run_table.json")
    with pytest.raises(ValueError) as refused:
        recordings.hermes_width_m(tmp_path, "bo-1")
    assert str(refused.value).startswith(f"{path}: ") and message in str(refused.value)


# The real recordings.

RUNS = ["bo-360-050-050", "boa-300-065-105", "bot-300-065-065", "uo-145-180-180"]


@pytest.mark.parametrize("run", RUNS)
def test_real_run_agrees_with_its_published_table(data_dir: Path, run: str) -> None:
    table = {entry["run"]: entry for entry in json.loads((data_dir / "hermes/run_table.json").read_bytes())}[run]
    recording = load_recording(recordings.hermes_path(data_dir, run), "hermes")
    width_m = recordings.hermes_width_m(data_dir, run)
    assert recording.num_people == table["peds"]
    assert recording.duration_s == pytest.approx(table["dur_s"], abs=0.15)
    x, y, vx, vy = recording.state_w.T
    corridor = np.abs(y) <= 4
    assert x[corridor].min() > 0 and x[corridor].max() < width_m
    assert y.min() < -6 and y.max() > 6  # the robot's two ends are inside the recording
    assert np.hypot(vx, vy)[corridor].mean() == pytest.approx(table["v_mean"], abs=0.03)
    # the table's greatest density is that of the middle four metres
    step = np.repeat(np.arange(recording.num_steps), np.diff(recording.frame_start))
    densest = np.bincount(step[np.abs(y) < 2]).max() / (4 * width_m)
    assert densest == pytest.approx(table["dens_max"], abs=0.1)
    assert recording.height_m.min() > 1.4 and recording.height_m.max() < 2.0


def test_real_sway_goes_and_the_way_stays(data_dir: Path) -> None:
    """Ripple at the stride and step frequencies of people who walk at 1.3 m/s, measured by a spectrum."""
    tracks = read_hermes(recordings.hermes_path(data_dir, "bo-360-050-050"))
    kept, moved = [], []
    for person in np.unique(tracks.person_id)[::4]:
        pos = tracks.pos_w[tracks.person_id == person][:112]
        smooth = remove_sway(pos, 16.0)
        spectra = [np.abs(np.fft.rfft(np.hanning(112) * np.gradient(p[:, 0]))) for p in (pos, smooth)]
        stride = slice(5, 8)  # .71 to 1.0 Hz, in 7 s
        kept.append(spectra[1][stride].max() / spectra[0][stride].max())
        moved.append(np.linalg.norm(smooth - pos, axis=1).max())
    assert np.median(kept) < 0.15
    assert 0.01 < np.median(moved) < 0.06  # 3 to 6 cm of sway, no more


def test_every_eth_ucy_file_can_be_replayed(data_dir: Path) -> None:
    files = sorted((data_dir / "eth_ucy").glob("*/*.txt"))
    files = [path for path in files if path.parent.name in ("all_data", "true_rate")]
    assert len(files) >= 10
    for path in files:
        recording = load_recording(path, "tracks")
        table = np.loadtxt(path)
        assert recording.max_people >= np.unique(table[:, 0], return_counts=True)[1].max() - 2
        assert recording.num_people >= 0.95 * len(np.unique(table[:, 1]))
        assert np.isfinite(recording.state_w).all()
