"""The component that CONTRIBUTING.md shows is run as it stands there, so that the guide cannot drift."""

import re
import runpy
import tomllib
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


def test_what_is_installed_is_pinned_with_hashes() -> None:
    """`make` installs what `.ci/lock` has written: the tested versions of all but torch, each file by its hash."""
    root = Path(__file__).parents[1]
    blocks = re.split(r"(?m)^(?=[a-z0-9])", (root / "requirements.lock").read_text(encoding="utf-8"))
    pinned = {block.split(" ", 1)[0] for block in blocks if block}
    assert all("--hash=sha256:" in block for block in blocks if block)
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    asked = [
        line for line in (root / "constraints.txt").read_text(encoding="utf-8").splitlines() if line[0] != "#"
    ]
    asked += [one for extra in ("dev", "blind") for one in project["optional-dependencies"][extra]]
    assert {re.sub(r"\[.*\]", "", one) for one in asked} - pinned == {"torch==2.13.0"}
    assert {re.split(r"[=>]", one)[0] for one in project["dependencies"]} <= {
        *(one.split("==")[0] for one in pinned), "torch",
    }  # fmt: skip
