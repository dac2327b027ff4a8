"""What the tests of the nodes share."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The policy that ships, exported, its kernels compiled: nodes then start within seconds."""
    from densecavoid.policy.folder_export import export_folder  # torch and rosbags may be missing
    from densecavoid.robot.config import RobotSettings
    from densecavoid.robot.folder import FolderPilot
    from densecavoid.robot.runtime import RobotRuntime

    exported = export_folder("densecavoid", tmp_path_factory.mktemp("export") / "exported")[0]
    RobotRuntime(FolderPilot(exported), RobotSettings(), threaded=False).warm_up()
    return exported
