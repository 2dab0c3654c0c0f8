"""The wheel holds all that the commands read: code, page template, study and twin files."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(next(WheelBuilder(str(ROOT)).build(directory=str(tmp_path_factory.mktemp("dist")))))


def test_wheel_holds_every_file_of_the_package(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    package = ROOT / "hybrid_id"
    files = [path for path in package.rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    assert {f"hybrid_id/{path.relative_to(package).as_posix()}" for path in files} <= names
    assert {f"hybrid_id/configs/{path.name}" for path in (ROOT / "configs").glob("*.yaml")} <= names


def test_unpacked_wheel_finds_its_data(wheel: Path, tmp_path: Path) -> None:
    zipfile.ZipFile(wheel).extractall(tmp_path / "site")
    code = (
        "from hybrid_id.reporting.page import Page; "
        "from hybrid_id.paper.stages import config_folder, read_plan; "
        "Page('title').html(); read_plan(quick=True); print(config_folder())"
    )
    run = [sys.executable, "-c", code]
    done = subprocess.run(
        run, capture_output=True, text=True, cwd=tmp_path, env={"PYTHONPATH": str(tmp_path / "site")}
    )
    assert done.returncode == 0, done.stderr
    assert str(tmp_path) in done.stdout
