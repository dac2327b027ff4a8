"""Promises of checkpoints: what comes back is what went in, and a crash leaves the old file whole."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from densecavoid.learning import checkpoint  # noqa: E402
from densecavoid.learning.checkpoint import load_checkpoint, save_checkpoint  # noqa: E402

STATE = {
    "tensor": torch.arange(6, dtype=torch.float32).reshape(2, 3).T,
    "nested": {"flags": np.array([True, False]), "big": np.array([2**64 - 1], np.uint64), "scalar": np.float64(0.1)},
    "plain": {"wide": 2**127 + 1, "list": [1, 2.5, None], "text": "ü", "empty": {}},
    "names": np.array(["random-goal", "a"]),
    "nothing": np.zeros((0, 3), np.int32),
}


def test_what_comes_back_is_what_went_in(tmp_path: Path) -> None:
    path = tmp_path / "c.safetensors"
    save_checkpoint(path, STATE)
    state = load_checkpoint(path)
    assert np.array_equal(state["tensor"], STATE["tensor"].numpy())
    for name, array in STATE["nested"].items():
        assert state["nested"][name].dtype == array.dtype
        assert np.array_equal(state["nested"][name], array)
    assert state["plain"] == STATE["plain"]
    assert np.array_equal(state["names"], STATE["names"])
    assert state["nothing"].shape == (0, 3)


def test_a_write_that_fails_leaves_the_old_checkpoint_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "c.safetensors"
    save_checkpoint(path, {"x": np.arange(3)})

    def full_disk(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(OSError, match=r"No space left on device; the file was left as it was.*c\.safetensors"):
        save_checkpoint(path, {"x": np.arange(1000)})
    monkeypatch.undo()
    assert np.array_equal(load_checkpoint(path)["x"], np.arange(3))
    assert [entry.name for entry in tmp_path.iterdir()] == ["c.safetensors"]


def test_a_process_killed_while_writing_leaves_the_old_checkpoint_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "c.safetensors"
    save_checkpoint(path, {"x": np.arange(3)})

    class Killed(BaseException):
        pass

    def killed(*_: object) -> None:
        raise Killed

    # Between the write of the new file and its renaming: nothing is cleaned up, as when the power goes.
    monkeypatch.setattr(checkpoint.os, "replace", killed)
    with pytest.raises(Killed):
        save_checkpoint(path, {"x": np.arange(1000)})
    monkeypatch.undo()
    assert np.array_equal(load_checkpoint(path)["x"], np.arange(3))
    save_checkpoint(path, {"x": np.arange(4)})
    assert np.array_equal(load_checkpoint(path)["x"], np.arange(4))


def test_what_cannot_be_stored_is_named(tmp_path: Path) -> None:
    for value in (object(), np.array([object()]), {1, 2}):
        with pytest.raises(TypeError, match="part/thing"):
            save_checkpoint(tmp_path / "c", {"part": {"thing": value}})
    assert not list(tmp_path.iterdir())


def test_files_that_are_no_checkpoints_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="there is no checkpoint"):
        load_checkpoint(tmp_path / "missing")
    (tmp_path / "text").write_text("hello")
    with pytest.raises(ValueError, match="text is not a checkpoint"):
        load_checkpoint(tmp_path / "text")
