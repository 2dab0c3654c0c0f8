"""docs/formats.md says what the program does."""

import re
from pathlib import Path

import pytest
import yaml

from hybrid_id.records.schema import DatasetFile
from hybrid_id.records.units import _KINDS
from hybrid_id.records.yaml_file import validate
from hybrid_id.systems.model_file import ModelFile, build_model
from hybrid_id.systems.model_schema import FLAT

DOCS = Path(__file__).resolve().parents[2] / "docs"
FORMATS = (DOCS / "formats.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("command, name", [("components", "coulomb_friction"), ("effects", "backlash")])
def test_commands_print_the_tables_that_the_docs_leave_to_them(run, command: str, name: str) -> None:
    words, table = run(command), run(command, "--markdown")
    assert words.code == table.code == 0 and name in words.out
    assert f"| `{name}` | " in table.out and "\n| --- | " in table.out


def test_examples_are_sound() -> None:
    dataset, model = (
        yaml.safe_load(t) for t in re.findall(r"^```yaml\n(.*?)^```", FORMATS, re.MULTILINE | re.DOTALL)
    )
    validate(DatasetFile, dataset, "formats.md")
    build_model(validate(ModelFile, model, "formats.md"))


def test_examples_of_records_are_sound() -> None:
    records = (DOCS / "records.md").read_text(encoding="utf-8")
    examples = re.findall(r"^```yaml\n(.*?)^```", records, re.MULTILINE | re.DOTALL)
    assert len(examples) >= 3
    for text in examples:
        rest = {"name": "example", "outputs": [{"name": "q_m1", "unit": "rad"}]}
        validate(DatasetFile, rest | yaml.safe_load(text), "records.md")


def test_every_channel_and_flat_name_is_there() -> None:
    names = {*_KINDS, *(name for flat in FLAT.values() for name in flat)}
    assert not {name for name in names if f"`{name}`" not in FORMATS}
