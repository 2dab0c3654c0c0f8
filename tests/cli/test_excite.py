"""`excite` on a model with a flexible gear."""

import json
from pathlib import Path

from drives import flexible_drive

from hybrid_id.systems.model_file import save_model


def test_it_says_which_part_of_the_band_it_takes(run, tmp_path: Path) -> None:
    save_model(flexible_drive(), tmp_path / "model.yaml", tmp_path)
    asked = f"excite --band 0.5 8 --tones 4 --duration 4 --starts 2 --amplitude 8 --out {tmp_path / 'u.csv'}"
    found = run(*f"{asked} --model {tmp_path / 'model.yaml'} --gear most".split())
    assert "the gear's deflection is" in found.out and "the largest of" in found.out
    made = json.loads((tmp_path / "u.json").read_text())
    assert made["band"] == made["gear_shares"][0]["band"]


def test_model_and_gear_go_together(run, tmp_path: Path) -> None:
    found = run(*f"excite --gear most --out {tmp_path / 'u.csv'}".split())
    assert found.code == 2 and "--model" in found.err
    assert not list(tmp_path.iterdir())
