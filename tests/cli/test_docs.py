"""Every block of the docs that is marked `python` or `sh` runs, page by page, and so do the notebooks."""

import json
import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

from hybrid_id.records.dataset import Dataset
from hybrid_id.reporting.scoreboard import ROWS

DOCS = Path(__file__).resolve().parents[2] / "docs"
ELSEWHERE = {"effects.md", "tour.md"}  # tests/diagnosis/test_effects_guide.py and test_readme.py run them
FENCE = re.compile(r"^```(python|sh)\n(.*?)^```", re.MULTILINE | re.DOTALL)
PAGES = {page.name: FENCE.findall(page.read_text(encoding="utf-8")) for page in sorted(DOCS.glob("*.md"))}


@pytest.fixture
def workplace(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    dataset = Dataset.load(drive)
    short = tuple(
        record.between(0.0, 0.3) for record in dataset.records
    )  # what is run matters, not what is found
    replace(dataset, records=short).save(tmp_path / "my_robot")
    shutil.copy(drive / "model.yaml", tmp_path / "my_robot")
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


def test_the_blind_check_is_short_and_says_what_each_row_means() -> None:
    text = (DOCS / "blind.md").read_text(encoding="utf-8")
    assert len(re.findall(r"\S*\w\S*", text)) <= 900
    missing = [words for words in ROWS.values() if words not in text]
    assert not missing, f"docs/blind.md does not explain {missing}"


@pytest.mark.parametrize(
    "page",
    [
        *(DOCS / f"{name}.md" for name in ("blind", "results", "measurements")),
        *sorted((DOCS / "boards").glob("*.md")),
    ],
    ids=lambda p: p.name,
)
def test_links_beside_the_figures_lead_somewhere(page: Path) -> None:
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    assert not [link for link in links if not (page.parent / link).exists()]


@pytest.mark.parametrize("page", ["results.md", "measurements.md"])
def test_a_result_is_one_short_row(page: str) -> None:
    tables = re.findall(
        r"^\| claim .*\n\| ---.*\n((?:\| .*\n)+)", (DOCS / page).read_text("utf-8"), re.MULTILINE
    )
    rows = [[cell.strip() for cell in row.split("|")[1:-1]] for table in tables for row in table.splitlines()]
    assert rows and not [row[0] for row in rows if len(row) != 6 or not all(row)]
    long = [row[0] for row in rows if len(re.sub(r"\(\[.*?\]\(.*?\)", "", row[2]).split()) > 50]
    assert not long, f"more than 50 words are seen; what does not fit goes to docs/measurements.md: {long}"


def test_a_change_takes_two_lines_of_the_changelog() -> None:
    text = (DOCS.parent / "CHANGELOG.md").read_text(encoding="utf-8")
    changes = re.findall(r"^- .*(?:\n  .*)*", text, re.MULTILINE)
    long = [c for c in changes if c.count("\n") > 1 or max(map(len, c.split("\n"))) > 130]
    assert changes and not long, f"more than two lines of 130 characters: {long}"
