"""Every block of the docs that is marked `python` or `sh` runs, page by page, and so do the notebooks."""

import json
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

import hybrid_id
from hybrid_id.reporting.scoreboard import ROWS

HOME = Path(__file__).resolve().parents[2]
DOCS = HOME / "docs"
MARKDOWN = [
    str(page.relative_to(HOME))
    for place in ("*.md", "docs/**/*.md", "experiments/*/*.md", "benchmarks/*.md")
    for page in sorted(HOME.glob(place))
]
ELSEWHERE = {"effects.md", "tour.md"}  # tests/diagnosis/test_effects_guide.py and test_readme.py run them
FENCE = re.compile(r"^```(python|sh)\n(.*?)^```", re.MULTILINE | re.DOTALL)
PAGES = {page.name: FENCE.findall(page.read_text(encoding="utf-8")) for page in sorted(DOCS.glob("*.md"))}


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


def test_each_published_report_is_listed_once() -> None:
    boards = DOCS / "boards"
    names = re.findall(
        r"^\| \[.*?\]\((.*?)\)", (boards / "README.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert sorted(names) == sorted(file.name for file in boards.glob("2*.md"))


MADE = {"equations.md", "api.md", "catalogue.md", "contributing.md"}
"""Pages of the site that docs/hooks.py makes."""


@pytest.mark.parametrize("page", MARKDOWN, ids=str)
def test_links_lead_somewhere(page: str) -> None:
    text = re.sub(
        r"^ *```.*?^ *```", "", (HOME / page).read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL
    )
    links = re.findall(r"\]\((?!https?:)([^)#:]+)(?:#[^)]*)?\)", text)
    assert not [link for link in links if link not in MADE and not ((HOME / page).parent / link).exists()]


def test_a_result_is_one_short_row_of_forty() -> None:
    lines = (DOCS / "results.md").read_text("utf-8").splitlines()
    rows = [
        line.split("|")[1:-1]
        for line in lines
        if line.startswith("| ") and not line.startswith(("| claim", "| ---"))
    ]
    assert 30 <= len(rows) <= 40 and not [
        row[0] for row in rows if len(row) != 6 or not all(c.strip() for c in row)
    ]
    assert not [row[0] for row in rows if len(" ".join(row).split()) > 45], "more than 45 words"


def test_docs_name_only_commits_that_git_holds() -> None:
    if not (HOME / ".git").exists() or shutil.which("git") is None:
        pytest.skip("no repository")
    named = {
        word
        for page in MARKDOWN
        for word in re.findall(r"\b[0-9a-f]{7,8}\b", (HOME / page).read_text(encoding="utf-8"))
        if re.search("[a-f]", word) and re.search("[0-9]", word)
    }
    asked = "".join(f"{word}^{{commit}}\n" for word in sorted(named))
    told = subprocess.run(
        ["git", "cat-file", "--batch-check"],
        cwd=HOME,
        input=asked,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    missing = [line.split("^")[0] for line in told.splitlines() if line.endswith("missing")]
    if len(missing) == len(named):
        pytest.skip("a clone without history")
    assert not missing


@pytest.mark.parametrize("page", [page for page in MARKDOWN if page.startswith("experiments/")])
def test_an_experiment_says_what_it_means_in_300_words(page: str) -> None:
    assert len(re.findall(r"\S*\w\S*", (HOME / page).read_text(encoding="utf-8"))) <= 300


@pytest.mark.parametrize("page", ["architecture.md", "why.md"])
def test_files_that_the_map_names_exist(page: str) -> None:
    """`records/readers/`, `fit.py: fit` and the like: a path as it is, a bare file somewhere in the package."""
    text = (DOCS / page).read_text(encoding="utf-8")
    named = re.findall(r"`([\w/]+(?:\.py|\.c|/))(?:: ([\w.]+))?`", text)
    package = Path(hybrid_id.__file__).parent
    assert len(named) >= 5
    for name, symbol in named:
        files = [file for place in (package, HOME) for file in place.glob(f"{name}")]
        files = files or list(package.rglob(name.split("/")[-1] or name))
        assert files, name
        for part in (symbol or "").split("."):
            assert any(
                file.is_dir() or re.search(rf"\b{part}\b", file.read_text("utf-8")) for file in files
            ), f"{name}: {part}"
