"""The effect that docs/effects.md adds is run as it stands there."""

# pyright: reportCallIssue=false

import re
import runpy
from collections.abc import Iterator
from pathlib import Path

import pytest
from gapcase import small_case

from hybrid_id.components.base import REGISTRY
from hybrid_id.diagnosis.catalogue import CATALOGUE, rivals
from hybrid_id.diagnosis.diagnose import diagnose

GUIDE = Path(__file__).resolve().parents[2] / "docs" / "effects.md"
RIVALS = ("cubic_spring", "spring_load", "constant_torque")


@pytest.fixture
def catalogue(tmp_path: Path) -> Iterator[None]:
    """The guide's effect is in the catalogue, few others are, and afterwards all is as it was."""
    source = re.findall(
        r"^```python\n(.*?)^```", GUIDE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
    )[0]
    file = tmp_path / "cubic_spring.py"
    file.write_text(source, encoding="utf-8")
    before = dict(REGISTRY), dict(CATALOGUE)
    try:
        runpy.run_path(str(file))
        for name in set(CATALOGUE) - set(RIVALS):
            del CATALOGUE[name]
        yield
    finally:
        for table, content in zip((REGISTRY, CATALOGUE), before, strict=True):
            table.clear()
            table.update(content)  # other tests walk them


@pytest.mark.usefixtures("catalogue")
def test_effect_of_the_guide_is_found() -> None:
    dataset, today = small_case(REGISTRY["cubic_spring"](k_3=0.5))
    found = diagnose(dataset, today, max_effects=1)
    assert "spring_load" in rivals("cubic_spring") and "cubic_spring" in rivals("spring_load")
    assert found.verdict == "effects" and [s.name for s in found.selected] == ["cubic_spring"]
    candidates = {s.name: s for s in found.effects}
    assert set(candidates) == set(RIVALS)
    first = found.search.steps[0]
    assert first.candidates[0].effects == (("cubic_spring", "joint1/load"),)
    assert first.candidates[0].validation.error < 0.05 * first.candidates[1].validation.error
    assert set(candidates["cubic_spring"].parameters) == {"k_3"}
