"""What every test shares: quiet numerics, repeatable hypothesis runs, and the data beside the project."""

import gc
import os

# Before numpy or torch is imported: the arrays are small, and pytest-xdist already uses every core.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from hybrid_id.diagnosis.arm import ArmDiagnosis
    from hybrid_id.diagnosis.result import Diagnosis
    from hybrid_id.identification.keep import Kept
    from hybrid_id.records.dataset import Dataset
    from hybrid_id.systems.chain import System

settings.register_profile("repeatable", derandomize=True, deadline=None, database=None)
settings.load_profile("repeatable")

SHARED = Path(__file__).resolve().parents[1] / ".." / "shared"


def pytest_collection_finish() -> None:
    """Leave what is imported out of garbage collections: passes over a million objects that stay take a twentieth."""
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)


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


@pytest.fixture(scope="session")
def kept(tmp_path_factory: pytest.TempPathFactory) -> "Kept":
    """Fits that one process of pytest-xdist has made and the others read: the same to the last bit."""
    from hybrid_id.identification.keep import Kept

    home = tmp_path_factory.getbasetemp()
    folder = (home.parent if "PYTEST_XDIST_WORKER" in os.environ else home) / "fits"
    folder.mkdir(exist_ok=True)
    return Kept(folder, "tests")


@pytest.fixture(scope="session")
def diagnosed(kept: "Kept") -> "tuple[Dataset, System, Diagnosis]":
    """Records of a drive with a spring at its link, the nominal model without it, and the diagnosis."""
    from gapcase import small_case

    from hybrid_id.components import REGISTRY
    from hybrid_id.diagnosis.diagnose import diagnose

    dataset, nominal = small_case(REGISTRY["spring_load"](k_s=0.6, q_s=0.3))
    return dataset, nominal, diagnose(dataset, nominal, max_effects=1, kept=kept)


@pytest.fixture(scope="session")
def sound(kept: "Kept") -> "tuple[Dataset, System, Diagnosis]":
    """Records of a drive whose model lacks nothing but the right values, the nominal model, and the diagnosis."""
    from gapcase import small_case

    from hybrid_id.diagnosis.diagnose import diagnose

    dataset, nominal = small_case()
    return dataset, nominal, diagnose(dataset, nominal, max_effects=1, kept=kept)


@pytest.fixture(scope="session")
def mended_arm(
    kept: "Kept", tmp_path_factory: pytest.TempPathFactory
) -> "tuple[Dataset, System, ArmDiagnosis]":
    """Records of an arm with a spring at its elbow, the nominal model without it, and the diagnosis.

    The catalogue holds what is missing, a near rival and a far one.
    """
    from gapcase import only
    from servo_arm import described, records_of

    from hybrid_id.components import REGISTRY
    from hybrid_id.diagnosis.arm import diagnose_arm

    pytest.importorskip("mujoco")
    nominal = described(tmp_path_factory.mktemp("mended_arm"))
    machine = nominal.with_component("joint3/load", REGISTRY["spring_load"](k_s=0.8, q_s=0.4))
    dataset = records_of(machine)
    with only("spring_load", "constant_torque", "quadratic_drag"):
        return dataset, nominal, diagnose_arm(dataset, nominal, kept=kept)
