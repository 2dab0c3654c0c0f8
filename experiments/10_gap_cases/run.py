"""Diagnose gap cases and hold the diagnoses against the answers: run.py FOLDER [CASE ...]."""

import json
import sys
from pathlib import Path

import yaml

from hybrid_id import Dataset, diagnose, load_model

HERE = Path(__file__).parent
settings = yaml.safe_load((HERE / "config.yaml").read_text())
folder = Path(sys.argv[1])
out = Path(settings["out"]) / folder.name
out.mkdir(parents=True, exist_ok=True)
for answer in sorted((folder / "answers").glob("*.yaml")):
    case, truth = answer.stem, yaml.safe_load(answer.read_text())
    if (sys.argv[2:] and case not in sys.argv[2:]) or not (folder / case).is_dir():
        continue
    kept = out / f"{case}.json"
    if not kept.exists():
        found = diagnose(
            Dataset.load(folder / case), load_model(folder / case / "model.yaml"), jobs=settings["jobs"]
        )
        kept.with_suffix(".new").write_text(json.dumps(found.as_dict()))
        kept.with_suffix(".new").replace(kept)
    said = json.loads(kept.read_text())
    effects, gap = said["effects"], said["gap"]
    chosen = [f"{e['name']}@{e['where']}" for e in effects if e["selected"]]
    ranks = [
        next((k for k, e in enumerate(effects, 1) if e["name"] in t["accept"] and e["where"] in t["accept_where"]), 99)
        for t in truth["effects"] if truth["family"] in ("single", "pair")
    ]  # fmt: skip
    print(
        f"{case} {truth['family']} {truth['level']}: {', '.join(t['name'] for t in truth['effects']) or 'nothing'} | "
        f"rank {ranks} | {said['verdict']} {', '.join(chosen)} | test error {gap['refit']:.4f} -> "
        f"{gap['with_effect']:.4f} (oracle {truth['oracle']['refit']:.4f} -> {truth['oracle']['with_effect']:.4f})"
    )
