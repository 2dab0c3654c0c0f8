"""Diagnose gap cases and hold the diagnoses against the answers: run.py FOLDER [CASE ...]."""

import sys
from pathlib import Path

import yaml

from hybrid_id import __version__
from hybrid_id.baselines.keep import is_done, key_of, load, save
from hybrid_id.baselines.run import Settings, read_case, run_case
from hybrid_id.machines.score import figures, judge
from hybrid_id.reporting.provenance import commit
from hybrid_id.reporting.scoreboard import ROWS, value

HERE = Path(__file__).parent
settings = yaml.safe_load((HERE / "config.yaml").read_text())
folder = Path(sys.argv[1])
out = Path(settings["out"]) / folder.name
out.mkdir(parents=True, exist_ok=True)
judged = []
for answer in sorted((folder / "answers").glob("*.yaml")):
    case, truth = answer.stem, yaml.safe_load(answer.read_text())
    if (sys.argv[2:] and case not in sys.argv[2:]) or not (folder / case).is_dir():
        continue
    records, asked = read_case(folder / case), Settings("diagnose")
    key = key_of(records, asked, __version__, commit())
    if not is_done(load(out, case), key):
        save(out, run_case(asked, records), key=key)
    said = load(out, case) or {}
    one, gap, oracle = judge(case, truth, said), said["gap"], truth["oracle"]
    judged.append(one)
    print(
        f"{case} {one.family} {one.level}: {one.effect} | {'all right' if one.whole else 'not all right'}, first name "
        f"{one.top_1}, place {one.place}, F1 {one.f1} | {said['verdict']}, "
        f"{', '.join(e['name'] + '@' + e['where'] for e in said['effects'] if e['selected'])} | test error "
        f"{gap['refit']:.4f} -> {gap['with_effect']:.4f} (oracle {oracle['refit']:.4f} -> {oracle['with_effect']:.4f})",
        flush=True,
    )
for name, score in figures(judged).items():
    print(f"{ROWS.get(name, name)}: {value(name, score)}")
