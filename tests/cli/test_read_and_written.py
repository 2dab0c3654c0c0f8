"""No command writes to a file that it reads, whatever it is told to replace (class 3 of what breaks programs)."""

import json
import shutil
from pathlib import Path

import pytest
import soak
import yaml
from command_line import whole

CASES = {
    "init": "init DATA --motor motor/model.yaml --out motor --force",
    "excite": "excite --model m.yaml --gear most --out m.yaml --force",
    "excite, its description": "excite --model m.json --gear most --out m.csv --force",
    "excite, a robot": "excite --model arm/model.yaml --out arm/arm.xml --force",
    "identify": "identify DATA --model m.yaml --out . --force",
    "identify, a study": "identify study.yaml --out DATA --force",
    "train": "train study.yaml --out DATA --force",
    "ablate": "ablate study.yaml --out DATA",
    "fleet": "fleet . --model m.yaml --out DATA",
    "diagnose": "diagnose DATA --model m.yaml --out DATA --force",
    "simulate": "simulate DATA --model m.yaml --out DATA --force",
    "compare": "compare DATA --model m.yaml --out DATA --force",
    "export, ranges": "export m.yaml --to ranges --out m.yaml --force",
    "export, torch": "export m.yaml --to torch --out m.yaml --force",
    "export, its description": "export m.json --to torch --out m.py --force",
    "export, mjcf": "export m.yaml --to mjcf --out m.yaml --force",
    "export, a robot": "export arm/model.yaml --to mjcf --out arm/arm.xml --force",
    "export, by a link": "export link.yaml --to ranges --out m.yaml --force",
    "export, beside a link": "export m.yaml --to ranges --out link.yaml --force",
    "export, a record": "export m.yaml --to mjcf --check DATA --out DATA/run_1.csv.gz --force",
    "demo": "demo --settings DATA/settings.yaml --out DATA --force",
}
SOONER = {
    "identify": "the folder that you are in",
    "ablate": "is not empty",
    "fleet": "is not empty",
    "export, beside a link": "a link or no regular file",
    "export, a record": "a record of the dataset beside it",
}
"""What is said of some before it is known that the command reads them."""
WITHOUT_INPUT = {"reproduce", "schema", "blind make"}
OWN = {"blind run"}
"""Goes on in the folder of runs that it has made."""


@pytest.fixture
def home(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The drive in a folder of results, so that nothing but its being read speaks against its replacement."""
    shutil.copytree(drive, tmp_path / "DATA")
    for name in ("m.yaml", "m.json", "m.png"):
        shutil.copy(drive / "model.yaml", tmp_path / name)
    (tmp_path / "link.yaml").symlink_to("m.yaml")
    (tmp_path / "study.yaml").write_text("dataset: DATA\n")
    (tmp_path / "motor").mkdir()
    (tmp_path / "motor" / "model.yaml").write_text(yaml.safe_dump({"gear_ratio": 10.0}))
    (tmp_path / "DATA" / "settings.yaml").write_text("{}\n")
    for folder in (tmp_path, tmp_path / "DATA"):
        (folder / "result.json").write_text(json.dumps({"program": "hybrid_id 1"}))
    monkeypatch.setattr(soak, "LONG", 1)
    soak.make_robot(tmp_path / "arm", 1)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", CASES)
def test_no_command_writes_to_what_it_reads(name: str, home: Path, run) -> None:
    before = {path: path.read_bytes() for path in home.rglob("*") if path.is_file()}
    outcome = run(*CASES[name].split())
    words = SOONER.get(name, "this command")
    assert outcome.code == 2
    assert outcome.err.splitlines()[-1].startswith("Error: ") and words in outcome.err
    after = {path: path.read_bytes() for path in home.rglob("*") if path.is_file()}
    assert after == before


def test_every_command_that_writes_is_tried() -> None:
    def names(command, above: str = "") -> list[str]:
        below = getattr(command, "commands", {}).items()
        mine = [above] if any("--out" in one.opts for one in command.params) else []
        return mine + [found for name, one in below for found in names(one, f"{above} {name}".strip())]

    tried = {case.partition(",")[0] for case in CASES}
    assert tried | WITHOUT_INPUT | OWN == set(names(whole()))
