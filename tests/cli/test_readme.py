"""The examples of the README and the commands of docs/tour.md run as they are written there."""

import re
import shlex
from pathlib import Path

import pytest
import yaml

from hybrid_id.records.schema import DatasetFile
from hybrid_id.records.yaml_file import validate
from hybrid_id.systems.model_file import ModelFile, build_model

HOME = Path(__file__).resolve().parents[2]
README = (HOME / "README.md").read_text(encoding="utf-8")
TOUR = (HOME / "docs/tour.md").read_text(encoding="utf-8")
NUMBER = r"\d+(?:\.\d+)?"


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", page, re.MULTILINE | re.DOTALL)


def commands(page: str) -> list[str]:
    lines = [line for block in blocks(page, "sh") for line in block.splitlines()]
    return [line for line in lines if line.startswith("hybrid-id ")]


def test_example_files_are_sound() -> None:
    dataset, model = (yaml.safe_load(text) for text in blocks(TOUR, "yaml"))
    validate(DatasetFile, dataset, "tour.md")
    system = build_model(validate(ModelFile, model, "tour.md"))
    assert "F_c" in {info.name for info in system.table}


@pytest.mark.parametrize("ending", ["", "identify", "train"])
def test_tour_names_the_commands(ending: str) -> None:
    assert any(ending in command for command in commands(TOUR))


def test_tour_runs_as_written(run, workplace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command in commands(TOUR):
        outcome = run(*shlex.split(command)[1:])
        assert outcome.code == 0, (command, outcome.err)
    assert {path.name for path in (workplace / "runs").iterdir()} == {
        "my_robot",
        "replay",
        "compare",
        "train",
    }
    assert (workplace / "multisine.csv").exists()
    names: dict[str, object] = {}
    for block in blocks(TOUR, "python"):
        exec(compile(block, "tour.md", "exec"), names)
    assert "selected set" in capsys.readouterr().out


def test_python_of_the_tour_that_takes_minutes_imports_what_there_is() -> None:
    found = blocks(TOUR, "pycon")
    assert len(found) == 5
    for block in found:
        source = "\n".join(line.removeprefix(">>> ") for line in block.splitlines())
        compile(source, "tour.md", "exec")
        exec("\n".join(line for line in source.splitlines() if line.startswith("from ")), {})


def test_every_command_of_the_tour_has_its_python() -> None:
    sections = re.split(r"^## ", TOUR, flags=re.MULTILINE)[1:]
    for section in sections:
        if "hybrid-id " in section:
            assert "```python" in section or "```pycon" in section, section.splitlines()[0]


def test_readme_commands_run_as_written(run, workplace: Path) -> None:
    assert "make demo " in README and "make test " in README and len(commands(README)) == 3
    for command in commands(README):
        outcome = run(*shlex.split(command)[1:])
        assert outcome.code == 0, (command, outcome.err)
    assert (workplace / "robot.xml").exists()


def test_readme_example_prints_what_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    (block,) = blocks(README, "python")
    exec(compile(block, "README.md", "exec"), {})
    printed = capsys.readouterr().out.splitlines()
    shown = [line for line in blocks(README, "text")[-1].splitlines() if line != "..."]
    words = [re.sub(NUMBER, "#", line).rstrip() for line in printed]
    for line in shown:
        real = printed[words.index(re.sub(NUMBER, "#", line).rstrip())]
        for told, found in zip(re.findall(NUMBER, line), re.findall(NUMBER, real), strict=True):
            assert float(told) == pytest.approx(float(found), rel=0.05, abs=0.01), (line, real)


def test_readme_is_short_and_its_links_lead_somewhere() -> None:
    assert len(README.split()) <= 550
    links = re.findall(r"\]\(([^)#:]+)\)", README)
    assert links and not [link for link in links if not (HOME / link).exists()]


def test_readme_results_stand_in_the_results_page() -> None:
    results = [
        set(re.findall(NUMBER, line))
        for line in (HOME / "docs/results.md").read_text(encoding="utf-8").splitlines()
        if line.startswith("| ")
    ]
    rows = [line for line in README.splitlines() if line.startswith("| ")][2:]
    assert len(rows) == 5
    for row in rows:
        assert any(set(re.findall(NUMBER, row)) <= figures for figures in results), (
            f"docs/results.md has no row with the figures of '{row}': take them from there"
        )
