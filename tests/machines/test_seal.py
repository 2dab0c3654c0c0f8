"""Sealed answers: same bytes for same sheets, a hash that is checked, and nothing that a run could read."""

from pathlib import Path

import pytest

from hybrid_id.errors import InputError
from hybrid_id.machines.seal import MANIFEST, open_answers, read_manifest, refuse_reachable, seal, was_sealed


def made(folder: Path) -> Path:
    """Two cases with answers beside them."""
    for name in ("c001", "c002"):
        (folder / name).mkdir(parents=True)
        (folder / name / "dataset.yaml").write_text(f"name: {name}\n")
        (folder / "answers").mkdir(exist_ok=True)
        (folder / "answers" / f"{name}.yaml").write_text(f"family: none\nseed: {name[-1]}\n")
    return folder


def test_same_answers_give_same_bytes(tmp_path: Path) -> None:
    archives = [tmp_path / f"{k}.tar" for k in range(2)]
    hashes = [
        seal(made(tmp_path / str(k)), archive, {"seed": 1})["answers"]["sha256"]
        for k, archive in enumerate(archives)
    ]
    assert archives[0].read_bytes() == archives[1].read_bytes()
    assert hashes[0] == hashes[1]


def test_sealed_answers_leave_the_folder_and_open_again(tmp_path: Path) -> None:
    cases, archive = made(tmp_path / "cases"), tmp_path / "sealed" / "a.tar"
    sealed = seal(cases, archive, {"seed": 1})
    assert sorted(p.name for p in cases.iterdir()) == ["c001", "c002", MANIFEST]
    assert read_manifest(cases) == sealed and sealed["names"] == ["c001", "c002"] and sealed["seed"] == 1
    sheets = open_answers(archive, sealed["answers"]["sha256"])
    assert sheets == {"c001": {"family": "none", "seed": 1}, "c002": {"family": "none", "seed": 2}}
    refuse_reachable(cases, tmp_path / "runs" / "a", sealed)


@pytest.mark.parametrize(
    "place", ["cases/x.tar", "cases/c001/x.tar", "cases/sub/x.tar", "x.tar", "deep/runs/x.tar", "deep/x.tar"]
)
def test_archive_is_found_under_any_name(tmp_path: Path, place: str) -> None:
    cases, archive = made(tmp_path / "cases"), tmp_path / place
    sealed = seal(cases, archive, {})
    with pytest.raises(InputError, match=r"x\.tar can be read by the run"):
        refuse_reachable(cases, tmp_path / "deep" / "runs", sealed)


@pytest.mark.parametrize("place", ["cases.answers/c001.yaml", "c001.yaml", "cases/c001/c002.yaml"])
def test_opened_sheets_are_found(tmp_path: Path, place: str) -> None:
    cases = made(tmp_path / "cases")
    sealed = seal(cases, tmp_path / "elsewhere" / "a.tar", {})
    (tmp_path / place).parent.mkdir(exist_ok=True)
    (tmp_path / place).write_text("family: none\n")
    with pytest.raises(InputError, match="can be read by the run"):
        refuse_reachable(cases, tmp_path / "runs" / "a", sealed)


def test_a_sealing_that_was_killed_before_its_last_step_is_known(tmp_path: Path) -> None:
    cases, archive = made(tmp_path / "cases"), tmp_path / "a.tar"
    assert not was_sealed(cases, archive)
    seal(cases, archive, {})
    (cases / "answers").mkdir()
    (cases / "answers" / ".c001.yaml.left").touch()
    assert was_sealed(cases, archive) and not (cases / "answers").exists()
    archive.write_bytes(b"others")
    assert not was_sealed(cases, archive)


def test_other_answers_are_refused(tmp_path: Path) -> None:
    cases, archive = made(tmp_path / "cases"), tmp_path / "a.tar"
    recorded = seal(cases, archive, {})["answers"]["sha256"]
    archive.write_bytes(archive.read_bytes().replace(b"family: none", b"family: pair"))
    with pytest.raises(InputError, match="not the archive that was sealed"):
        open_answers(archive, recorded)
    with pytest.raises(InputError, match="cannot be read"):
        open_answers(tmp_path / "nothing.tar", recorded)


def test_a_case_without_an_answer_is_not_sealed(tmp_path: Path) -> None:
    cases = made(tmp_path / "cases")
    (cases / "answers" / "c002.yaml").unlink()
    with pytest.raises(InputError, match="lacks the answers to c002"):
        seal(cases, tmp_path / "a.tar", {})
    assert not (tmp_path / "a.tar").exists() and not (cases / MANIFEST).exists()
