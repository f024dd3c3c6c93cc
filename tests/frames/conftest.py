"""Where rendered frames lie: beside the repository, or where SSSFIT_FRAMES says; they are no part of it."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def rendered():
    """The folder of the rendered scenes."""
    beside = Path(__file__).resolve().parents[3] / "shared" / "frames"
    folder = Path(os.environ.get("SSSFIT_FRAMES", beside))
    if not (folder / "s1_beam" / "camera.json").exists():
        pytest.skip(f"the rendered frames are not here (in {folder}, or where SSSFIT_FRAMES says)")
    return folder
