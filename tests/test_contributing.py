"""The component that CONTRIBUTING.md shows is run as it stands there, so that the guide cannot drift."""

import re
import runpy
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import torch

from hybrid_id.components.base import CATALOGUE, REGISTRY

GUIDE = Path(__file__).resolve().parents[1] / "CONTRIBUTING.md"


def test_component_of_the_guide_works(tmp_path: Path) -> None:
    (source,) = re.findall(r"```python\n(.*?)```", GUIDE.read_text(encoding="utf-8"), flags=re.DOTALL)
    file = tmp_path / "quadratic_drag.py"
    file.write_text(source, encoding="utf-8")
    tables = cast("list[dict]", [REGISTRY, CATALOGUE])
    before = [dict(table) for table in tables]
    try:
        law = runpy.run_path(str(file))["QuadraticDrag"](F_q=2e-7)
        assert law.kind in REGISTRY
    finally:
        for table, content in zip(tables, before, strict=True):
            table.clear()
            table.update(content)  # other tests walk them
    speed = torch.tensor([-3.0, 0.0, 3.0], dtype=torch.float64)
    torque = law.smooth(SimpleNamespace(F_q=torch.tensor([2e-7], dtype=torch.float64)), speed)
    torch.testing.assert_close(torque, 2e-7 * torch.tensor([-9.0, 0.0, 9.0], dtype=torch.float64))
    assert source.count("\n") <= 40  # law, suspicion and words
    assert (GUIDE.parent / "hybrid_id/components/friction/quadratic_drag.py").read_text(
        encoding="utf-8"
    ) == source
