"""What the tests of the nodes share."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The policy that ships, exported."""
    from densecavoid.policy.folder_export import export_folder  # torch and rosbags may be missing

    return export_folder("densecavoid", tmp_path_factory.mktemp("export") / "exported")[0]
