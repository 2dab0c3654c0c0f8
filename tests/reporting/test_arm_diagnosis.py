"""A robot's diagnosis in words and tables: what a joint lacks, how large its errors are, and in which unit."""

import pytest

from hybrid_id.diagnosis.arm import ArmDiagnosis
from hybrid_id.reporting.arm_diagnosis import joints_table

pytest.importorskip("mujoco")


@pytest.fixture
def found(mended_arm) -> ArmDiagnosis:
    return mended_arm[2]


def cells(found: ArmDiagnosis) -> dict[str, list[str]]:
    """The table of joints, column by column."""
    return {str(c.header): [str(cell) for cell in c.cells] for c in joints_table(found).columns}


def test_each_model_has_a_column_of_errors_of_its_own(found: ArmDiagnosis) -> None:
    shown = cells(found)
    heads = ["RMSE nominal", "RMSE re-fitted", "RMSE corrected", "unit"]
    assert list(shown)[-4:] == heads
    row = shown["joint"].index("elbow")
    nominal, refitted, corrected = (float(shown[head][row]) for head in heads[:3])
    assert nominal > refitted > corrected and shown["unit"] == ["rad"] * 3
