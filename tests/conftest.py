"""What every test shares: quiet numerics, repeatable hypothesis runs, and the data beside the project."""

import os

# Before numpy or torch is imported: the arrays are small, and pytest-xdist already uses every core.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

settings.register_profile("repeatable", derandomize=True, deadline=None, database=None)
settings.load_profile("repeatable")

SHARED = Path(__file__).resolve().parents[1] / ".." / "shared"


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder of real records beside the project; the test is skipped where it is absent."""
    if not SHARED.is_dir():
        pytest.skip("needs the folder of real records, shared/, beside the project")
    return SHARED


@pytest.fixture
def rng() -> np.random.Generator:
    """A seeded source of random numbers, the same for every test."""
    return np.random.default_rng(20240607)
