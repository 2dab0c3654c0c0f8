"""The commands of the README's tour run as they are written there."""

import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from hybrid_id.records.dataset import Dataset
from hybrid_id.records.schema import DatasetFile
from hybrid_id.records.yaml_file import validate
from hybrid_id.systems.model_file import ModelFile, build_model, values_of

README = Path(__file__).resolve().parents[2] / "README.md"
BLOCKS = re.findall(r"^```sh\n(.*?)^```", README.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
COMMANDS = [line for block in BLOCKS for line in block.splitlines() if line.startswith("hybrid-id ")]
YAML = re.findall(r"^```yaml\n(.*?)^```", README.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
PYTHON = re.findall(r"^```python\n(.*?)^```", README.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def test_example_files_are_sound() -> None:
    dataset, model = (yaml.safe_load(text) for text in YAML)
    validate(DatasetFile, dataset, "README.md")
    assert "F_c" in values_of(build_model(validate(ModelFile, model, "README.md")))


@pytest.mark.parametrize("ending", ["", "identify", "train"])
def test_tour_names_the_commands(ending: str) -> None:
    assert any(ending in command for command in COMMANDS)


def test_tour_runs_as_written(
    run, drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    dataset = Dataset.load(drive)
    short = tuple(record.between(0.0, 0.3) for record in dataset.records[1:])  # more take a minute
    replace(dataset, records=short).save(tmp_path / "my_robot")
    shutil.copy(drive / "model.yaml", tmp_path / "my_robot")
    shutil.copy(drive / "model.yaml", tmp_path / "my_robot" / "model_priors.yaml")
    monkeypatch.chdir(tmp_path)
    for command in COMMANDS:
        outcome = run(*shlex.split(command)[1:])
        assert outcome.code == 0, (command, outcome.err)
    assert {path.name for path in (tmp_path / "runs").iterdir()} == {"my_robot", "replay", "compare", "train"}
    assert (tmp_path / "multisine.csv").exists()
    (block,) = PYTHON
    exec(compile(block, "README.md", "exec"), {})
    assert "selected set" in capsys.readouterr().out
