"""Lines of code and words of documentation stay within what `lines.toml` allows."""

import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
CODE = {".py", ".c", ".h", ".j2", ".yaml"}
BUDGET = tomllib.loads((ROOT / "lines.toml").read_text(encoding="utf-8"))


def files(folder: Path, endings: set[str]) -> list[Path]:
    """Files that the project holds, without hidden folders, environments and results."""
    return [
        path
        for path in folder.rglob("*")
        if path.suffix in endings
        and not any(
            part[0] == "." or part in ("runs", "site", "build") for part in path.relative_to(ROOT).parts
        )
    ]


def lines(paths: list[Path]) -> int:
    return sum(len(path.read_bytes().splitlines()) for path in paths)


def spent() -> dict[str, int]:
    """Lines by part of the project, and words of its Markdown files."""
    package = ROOT / "hybrid_id"
    used = {"top level": lines([path for path in files(package, CODE) if path.parent == package])}
    used |= {
        path.name: lines(files(path, CODE))
        for path in sorted(package.iterdir())
        if path.is_dir() and files(path, CODE)
    }
    used |= {name: lines(files(ROOT / name, CODE)) for name in ("tests", "experiments", "benchmarks")}
    used["words"] = sum(len(path.read_text(encoding="utf-8").split()) for path in files(ROOT, {".md"}))
    return used


ALLOWED = {**BUDGET["package"], **BUDGET["beside"]}


def test_every_part_has_a_budget_within_the_ceilings() -> None:
    assert set(ALLOWED) == set(spent())
    assert sum(BUDGET["package"].values()) <= BUDGET["ceiling"]["package"]
    for name, ceiling in BUDGET["ceiling"].items():
        assert name == "package" or BUDGET["beside"][name] <= ceiling


@pytest.mark.parametrize("part", ALLOWED)
def test_no_part_exceeds_its_budget(part: str) -> None:
    used = spent()[part]
    assert used <= ALLOWED[part], (
        f"{part}: {used}, {used - ALLOWED[part]} more than lines.toml allows; remove a mechanism, or raise the line "
        "in a commit that says why"
    )
