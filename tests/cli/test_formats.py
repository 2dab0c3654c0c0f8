"""docs/formats.md says what the program does."""

import re
from pathlib import Path

import yaml

from hybrid_id.records.schema import DatasetFile
from hybrid_id.records.units import _KINDS
from hybrid_id.records.yaml_file import validate
from hybrid_id.systems.model_file import ModelFile, build_model
from hybrid_id.systems.model_schema import FLAT

FORMATS = (Path(__file__).resolve().parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")


def test_table_of_components_is_the_one_that_the_command_prints(run) -> None:
    assert run("components", "--markdown").out.strip() in FORMATS
    words = run("components")
    assert words.code == 0
    assert "coulomb_friction" in words.out


def test_examples_are_sound() -> None:
    dataset, model = (
        yaml.safe_load(t) for t in re.findall(r"^```yaml\n(.*?)^```", FORMATS, re.MULTILINE | re.DOTALL)
    )
    validate(DatasetFile, dataset, "formats.md")
    build_model(validate(ModelFile, model, "formats.md"))


def test_every_channel_and_flat_name_is_there() -> None:
    names = {*_KINDS, *(name for flat in FLAT.values() for name in flat)}
    assert not {name for name in names if f"`{name}`" not in FORMATS}
