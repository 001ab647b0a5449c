"""What several tests are given."""

from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four samples of rolled sheets in photos of 48 px."""
    from simple_samples import simple_dataset  # not before the checks of types are in place, which are after this file

    return simple_dataset(tmp_path_factory.mktemp("data"))
