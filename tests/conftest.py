"""Fixtures that several test modules share."""

from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four samples of rolled sheets in photos of 48 px."""
    from simple_samples import simple_dataset  # not at the top, as type checks are installed only after this file loads

    return simple_dataset(tmp_path_factory.mktemp("data"))
