"""Every block of the docs that is marked `python` or `sh` runs, page by page, and so do the notebooks."""

import json
import re
import shlex
import shutil
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
ELSEWHERE = {"effects.md"}  # tests/diagnosis/test_effects_guide.py runs it
FENCE = re.compile(r"^```(python|sh)\n(.*?)^```", re.MULTILINE | re.DOTALL)
PAGES = {page.name: FENCE.findall(page.read_text(encoding="utf-8")) for page in sorted(DOCS.glob("*.md"))}


@pytest.fixture
def workplace(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(drive, tmp_path / "my_robot")
    shutil.copy(drive / "model.yaml", tmp_path / "my_robot" / "model_priors.yaml")  # the demo has one
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("page", [name for name, blocks in PAGES.items() if blocks and name not in ELSEWHERE])
def test_page_runs_as_written(run, workplace: Path, page: str) -> None:
    names: dict[str, object] = {}
    for language, text in PAGES[page]:
        if language == "python":
            exec(compile(text, page, "exec"), names)
            continue
        for line in text.splitlines():
            program, *arguments = shlex.split(line)
            assert program == "hybrid-id", f"{page}: mark '{line}' as console, or let a test run it"
            if "mjcf" in arguments:
                pytest.importorskip("mujoco")
            done = run(*arguments)
            assert done.code == 0, (line, done.err)


@pytest.mark.parametrize("notebook", sorted(path.name for path in (DOCS / "notebooks").glob("*.ipynb")))
def test_notebook_runs(workplace: Path, notebook: str) -> None:
    cells = json.loads((DOCS / "notebooks" / notebook).read_text(encoding="utf-8"))["cells"]
    names: dict[str, object] = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            assert not cell["outputs"], "clear the outputs: what a run prints is not part of the source"
            exec(compile("".join(cell["source"]), notebook, "exec"), names)
    plt.close("all")


def test_site_builds_without_a_warning(tmp_path: Path) -> None:
    config = pytest.importorskip("mkdocs.config")
    from mkdocs.commands.build import build
    from mkdocs.exceptions import Abort

    settings = config.load_config(
        str(DOCS.parent / "mkdocs.yml"), site_dir=str(tmp_path / "site"), strict=True
    )
    try:
        build(settings)
    except Abort as error:
        pytest.fail(str(error))
    assert "tau_m = P_m1 (U - P_m2 v)" in (tmp_path / "site/equations/index.html").read_text(encoding="utf-8")
    assert "with_component" in (tmp_path / "site/concepts/index.html").read_text(encoding="utf-8")
