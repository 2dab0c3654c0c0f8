"""Sealing: answers go into an archive apart, and its hash into a manifest beside the cases."""

import hashlib
import io
import json
import shutil
import tarfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hybrid_id.errors import InputError
from hybrid_id.reading import LARGEST_RESULT, PLAIN_NAME, read_bytes, read_object
from hybrid_id.records.files import write_whole
from hybrid_id.records.manifest import check_manifest
from hybrid_id.records.yaml_file import parse_yaml

MANIFEST, ANSWERS = "manifest.json", "answers"

Truth = dict[str, Any]
"""The content of one ground truth."""


def pack(folder: Path) -> bytes:
    """The ground truths of a folder as one archive, whose bytes depend on nothing but names and contents.

    It is not compressed, since compressed bytes depend on the version of the library.
    """
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for path in sorted(folder.glob("*.yaml")):
            entry, content = tarfile.TarInfo(path.name), path.read_bytes()
            entry.size, entry.mode = len(content), 0o644
            archive.addfile(entry, io.BytesIO(content))
    return file.getvalue()


def seal(cases: Path, archive: Path | None, about: Mapping[str, Any]) -> dict[str, Any]:
    """Write the manifest of a folder of cases, and move their answers into an archive.

    Args:
        cases: folder of the cases, with their answers in `answers/`.
        archive: file that takes the answers; None leaves them where they are, open, for development.
        about: what else the manifest holds, say seed and version.

    Returns:
        The manifest.

    Raises:
        InputError: a case has no answers, or there is no case.
    """
    names = case_names(cases)
    if missing := [name for name in names if not (cases / ANSWERS / f"{name}.yaml").is_file()]:
        raise InputError(f"{cases} lacks the answers to {', '.join(missing[:5])}; make the cases anew")
    content = pack(cases / ANSWERS)
    manifest = {
        **about,
        "names": names,
        "answers": {"sealed": archive is not None, "sha256": hashlib.sha256(content).hexdigest()},
    }
    if archive is not None:
        archive.parent.mkdir(parents=True, exist_ok=True)
        write_whole(archive, content)
    write_whole(cases / MANIFEST, json.dumps(manifest, indent=1) + "\n")
    if archive is not None:
        shutil.rmtree(cases / ANSWERS)
    return manifest


def is_half_sealed(cases: Path, archive: Path) -> bool:
    """Whether an archive holds the answers beside the cases, for want of a manifest only."""
    unsealed = (cases / ANSWERS).is_dir() and not (cases / MANIFEST).exists()
    return unsealed and archive.is_file() and archive.read_bytes() == pack(cases / ANSWERS)


def was_sealed(cases: Path, archive: Path) -> bool:
    """Whether an archive holds the answers to the cases already; copies that a killed run has left beside them go."""
    if not (cases / MANIFEST).is_file() or not archive.is_file():
        return False
    same = read_manifest(cases)["answers"]["sha256"] == _hash(archive)
    if same:
        shutil.rmtree(cases / ANSWERS, ignore_errors=True)
    return same


def case_names(cases: Path) -> list[str]:
    """Names of the cases in a folder, sorted."""
    if not cases.is_dir():
        raise InputError(f"{cases} is no folder of cases; 'hybrid-id blind make' makes one")
    found = sorted(path.parent.name for path in cases.glob("*/dataset.yaml") if path.parent.name[0] != ".")
    if not found:
        raise InputError(f"{cases} holds no case; 'hybrid-id blind make' makes some")
    return found


def read_manifest(cases: Path) -> dict[str, Any]:
    """The manifest of a folder of cases.

    Raises:
        InputError: there is none, or it cannot be read.
    """
    file = cases / MANIFEST
    try:
        manifest = read_object(file, "manifest of cases")
    except OSError:
        raise InputError(
            f"{cases} has no {MANIFEST}; make the cases with 'hybrid-id blind make', which seals their answers"
        ) from None
    check_manifest(manifest, file)
    if "names" not in manifest:
        raise InputError(f"{file} names no cases; make the cases anew")
    return manifest


def refuse_reachable(cases: Path, runs: Path, manifest: Mapping[str, Any]) -> None:
    """Raise InputError where answers lie in the folder of the cases or of the runs, or beside either.

    The archive is found under any name, as long as nobody has packed it once more.

    Args:
        cases: folder of the cases.
        runs: folder of the diagnoses; need not exist.
        manifest: of the cases.
    """
    cases, runs = cases.resolve(), runs.resolve()
    sheets = {f"{name}.yaml" for name in manifest["names"]}
    beside = [path for folder in (cases.parent, runs.parent) for path in _listed(folder, "*")]
    for path in dict.fromkeys((*_listed(cases, "**/*"), *_listed(runs, "**/*"), *beside)):
        named = ANSWERS in path.name.split(".") or path.name in sheets
        if named or (_is_archive(path) and _hash(path) == manifest["answers"]["sha256"]):
            raise InputError(
                f"{path} can be read by the run, which must not see answers; move it to another folder"
            )


def _listed(folder: Path, pattern: str) -> list[Path]:
    return sorted(folder.glob(pattern)) if folder.is_dir() else []


def _is_archive(path: Path) -> bool:
    """Whether a path, whatever its name, is a file that begins as an archive; what cannot be read is none."""
    try:
        if not path.is_file():  # a pipe would be waited for
            return False
        with path.open("rb") as file:
            return file.read(262)[257:] == b"ustar"
    except OSError:
        return False


def open_answers(archive: Path, sha256: str) -> dict[str, Truth]:
    """The ground truths of an archive by case.

    Args:
        archive: file of the answers.
        sha256: its hash as it was recorded before the run.

    Raises:
        InputError: the archive is another one, or cannot be read.
    """
    try:
        content = read_bytes(archive, LARGEST_RESULT, "archive of answers")
    except OSError as error:
        raise InputError(f"answers {archive} cannot be read ({error.strerror}); give another file") from None
    if hashlib.sha256(content).hexdigest() != sha256:
        raise InputError(
            f"{archive} is not the archive that was sealed before the run, which had the hash {sha256[:16]}…; "
            "no score is given"
        )
    try:
        with tarfile.open(fileobj=io.BytesIO(content), mode="r:") as file:
            sheets = {}
            for entry in file:  # read where it lies; nothing is ever extracted
                place = Path(entry.name)
                stream = file.extractfile(entry) if entry.isreg() else None
                if stream is None or not PLAIN_NAME.fullmatch(entry.name) or place.suffix != ".yaml":
                    raise InputError(
                        f"answers {archive} hold '{entry.name[:100]}', which is no answer; make the cases anew"
                    )
                sheets[place.stem] = parse_yaml(stream.read().decode("utf-8"), archive / entry.name)
                if not isinstance(sheets[place.stem], dict):
                    raise InputError(
                        f"{archive / entry.name} holds no 'key: value' pairs; make the cases anew"
                    )
            return sheets
    except (tarfile.TarError, UnicodeDecodeError) as error:
        raise InputError(f"answers {archive} cannot be read ({error}); make the cases anew") from None


def _hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
