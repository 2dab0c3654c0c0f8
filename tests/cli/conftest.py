"""The command line in process, on a small drive whose identification takes a second."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from drives import make_records, multisine, rigid_drive
from malformed import write_sound_dataset
from malformed_models import write_sound_model
from typer.testing import CliRunner

from hybrid_id.cli.app import app
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.systems.model_file import save_model

PLAIN = "output: {figures: false, tensorboard: false, report: false}\n"


class Outcome:
    """Exit code, what was printed, and what was said beside it."""

    def __init__(self, *args: object) -> None:
        result = CliRunner().invoke(app, [str(arg) for arg in args])
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        self.code, self.out, self.err = result.exit_code, result.stdout, result.stderr


@pytest.fixture(scope="session")
def run() -> type[Outcome]:
    """Run a command line in process; what is not meant for the user is raised."""
    return Outcome


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Dataset folder of four short records, one of them for the test, with a model whose start values are off."""
    truth, noise = rigid_drive(), {"q_m1": 0.01}
    voltages = [multisine(seed, samples=600, amplitude=6.0 + seed) for seed in range(4)]
    records = make_records(truth, voltages, noise=noise)
    records[3] = replace(records[3], role="test")
    folder = tmp_path_factory.mktemp("records") / "drive"
    channels = (Channel("u1", "V"),), (Channel("q_m1", "rad", 0.01),)
    Dataset("small drive", *channels, tuple(records), 0.002).save(folder)
    start = truth.with_values({"J": 2.4e-5, "F_c": 0.008, "F_v": 6e-5})
    held = {name: replace(start.parameter(name).spec, estimate=False) for name in ("P_m1", "P_m2")}
    save_model(start.with_specs(held), folder / "model.yaml")
    return folder


@pytest.fixture(scope="session")
def plain(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Study file of the drive without pictures, events and page, which take longer than most of what is tested."""
    file = tmp_path_factory.mktemp("plain") / "study.yaml"
    file.write_text(f"dataset: {drive}\n{PLAIN}")
    return file


@pytest.fixture
def sound(tmp_path: Path) -> tuple[Path, Path]:
    """A sound dataset and a sound model, with little in them."""
    for name in ("data", "model"):
        (tmp_path / name).mkdir()
    return write_sound_dataset(tmp_path / "data"), write_sound_model(tmp_path / "model")


@pytest.fixture
def workplace(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder that one is in, with the drive as my_robot, short: what is run matters, not what is found."""
    dataset = Dataset.load(drive)
    short = tuple(record.between(0.0, 0.3) for record in dataset.records)
    replace(dataset, records=short).save(tmp_path / "my_robot")
    for name in ("model.yaml", "model_priors.yaml"):  # the demo has both
        shutil.copy(drive / "model.yaml", tmp_path / "my_robot" / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path
