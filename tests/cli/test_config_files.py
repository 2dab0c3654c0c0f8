"""The study files that ship with the package."""

from pathlib import Path

import pytest

from hybrid_id.config import StudyConfig, load_config

CONFIGS = sorted((Path(__file__).resolve().parents[2] / "configs").glob("study_*.yaml"))


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_shipped_config_is_sound(path: Path) -> None:
    assert load_config(path).output.folder is not None


def test_there_is_an_example() -> None:
    assert CONFIGS


def test_comments_of_the_example_tell_the_defaults() -> None:
    config = load_config(CONFIGS[0].with_name("study_link1.yaml"))
    sections = "preprocessing", "identification", "training", "gap", "statistics"
    defaults = StudyConfig(dataset=config.dataset, model=config.model)
    for section in sections:
        assert getattr(config, section) == getattr(defaults, section)
