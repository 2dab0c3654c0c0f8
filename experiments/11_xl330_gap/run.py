"""What a diagnosis says of a real servo whose facts are known: run.py FOLDER [CASE ...] (README.md beside this)."""

import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_id import Dataset
from hybrid_id.components import REGISTRY
from hybrid_id.gap.diagnosis import Diagnosis, diagnose
from hybrid_id.parameters import Bounded
from hybrid_id.records.dataset import Channel
from hybrid_id.records.readers.bam import read_bam
from hybrid_id.records.record import Record
from hybrid_id.records.resample import resample_record
from hybrid_id.records.yaml_file import read_yaml
from hybrid_id.study.identifiable import preflight
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_file import ModelFile, build_model

CONFIG = read_yaml(Path(__file__).with_name("config.yaml"))
FRICTION = "joint1/motor_friction"


def dataset(records: list[Record], case: dict[str, Any]) -> Dataset:
    """Records with PWM and measured supply as inputs, or with their product where the supply is said to be constant."""
    names = ("enable1",) if "supply" in case else ("duty1", "supply1", "enable1")
    made = []
    for record in records:
        inputs = {name: record.signal(name) for name in names}
        if "supply" in case:
            inputs["u1"] = record.signal("duty1") * case["supply"]
        role = "test" if record.signal("gain1")[0] == case["test"] else "train"
        outputs = {"q_m1": record.signal("q_m1")}
        made.append(replace(record, inputs=inputs, outputs=outputs, role=role))
    inputs = tuple(Channel(n, "V" if n in ("u1", "supply1") else "1") for n in made[0].inputs)
    outputs = (Channel("q_m1", "rad", CONFIG["encoder_step"]),)
    return Dataset("xl330", inputs, outputs, tuple(made), CONFIG["sample_time"])


def today(case: dict[str, Any]) -> System:
    """The model that a case starts from, open loop; a claimed mass changes gravity."""
    drive = "voltage" if "supply" in case else "duty_supply"
    system = build_model(ModelFile.model_validate(CONFIG["model"]))
    system = system.with_component("joint1/input", REGISTRY[drive]())
    for kind, values in case.get("known", {}).items():
        law = REGISTRY[kind](**{name: Bounded(*limits) for name, limits in values.items()})
        system = system.with_component(FRICTION, law)
    share = case.get("mass", CONFIG["true_mass"]) / CONFIG["true_mass"]
    return system.with_values({"G_l": share * system.parameter("G_l").spec.value})


def facts(folder: Path, records: list[Record]) -> None:
    """What the logs say without a model: gain against temperature, and what the measured supply follows."""
    gains, heat, drawn, measured = [], [], [], []
    for file, record in zip(sorted(folder.glob("*.json*")), records, strict=True):
        columns = read_bam(file, ["gain1", "temperature1"]).columns
        gains.append(columns["gain1"][0])
        heat.append(columns["temperature1"].mean())
        on, duty, supply = (record.signal(name) for name in ("enable1", "duty1", "supply1"))
        speed = np.gradient(record.signal("q_m1"), record.time)
        columns = np.stack([np.ones_like(duty), duty**2 * supply, duty * speed], 1)
        drawn.append(columns[on > 0.5])
        measured.append(supply[on > 0.5])
    print(f"gain and temperature of {len(gains)} records: correlation {np.corrcoef(gains, heat)[0, 1]:.2f}")
    for gain in sorted(set(gains)):
        some = [h for g, h in zip(gains, heat, strict=True) if g == gain]
        print(f"  gain {gain:.0f}: {min(some):.1f} to {max(some):.1f} degC")
    x, y = np.concatenate(drawn), np.concatenate(measured)
    law = np.linalg.lstsq(x, y, rcond=None)[0]
    explained = 1.0 - np.var(y - x @ law) / np.var(y)
    print(
        f"measured supply: {y.min():.1f} to {y.max():.1f} V, mean {y.mean():.2f}, std {y.std():.2f}; "
        f"the current drawn explains {100 * explained:.1f} % of its variance (rho {-law[1]:.3f})"
    )


def told(records: list[Record], case: dict[str, Any]) -> None:
    """What the records of a case could tell of a mass that nobody claims to know."""
    system = today(case)
    weight = replace(system.parameter("G_l").spec, estimate=True, lower=0.01, upper=5.0)
    print(
        f"  with G_l free: {preflight(dataset(records, case), system.with_specs({'G_l': weight})).summary()}"
    )


def report(name: str, found: Diagnosis, seconds: float) -> None:
    """A case in a few lines, and its diagnosis.json."""
    gap = found.shrink
    assert gap is not None and found.nominal is not None
    low, high = gap.interval
    named = ", ".join(f"{s.name} {s.probability:.2f}" for s in found.selected) or "nothing named"
    print(
        f"{name}: {found.verdict}; {named} | test error {found.nominal.nrmse:.3f} -> {gap.refit:.3f} -> "
        f"{gap.with_effect:.3f}, floor {gap.floor:.3f}, shrink {gap.share:.2f} [{low:.2f}, {high:.2f}] | "
        f"{seconds:.0f} s of processor time"
    )
    for suspect in found.selected:
        values = ", ".join(f"{n} {v:.3g} +- {s:.2g}" for n, (v, s) in suspect.parameters.items())
        print(f"  {suspect.name}: {values}; tied with {', '.join(suspect.tied_with) or 'none'}")
    for number, one in enumerate(found.search.rounds, start=1):
        before, rivals = one.before.evidence, []
        for rival in one.candidates:
            new = next(n for n, _ in rival.effects if n not in [n for n, _ in one.before.effects])
            ratio = (before.error / rival.evidence.error) ** 0.5
            rivals.append(f"{new} {ratio:.3f} (z {rival.evidence.z(before):.1f})")
        shown = rivals if number == 1 else rivals[:4]
        print(f"  round {number}, RMS error before over after: {', '.join(shown)}")
    values = {i.name: i.spec.value for i in found.model.table if i.spec.estimate}
    print(f"  model: {', '.join(f'{n} {v:.4g}' for n, v in values.items())}")
    print(f"  bent: {'; '.join(found.bent) or 'nothing'}", flush=True)
    out = Path(CONFIG["out"])
    out.mkdir(parents=True, exist_ok=True)
    partial = out / f".{name}.json"
    partial.write_text(json.dumps(found.as_dict(), indent=1))
    partial.replace(out / f"{name}.json")


def main() -> None:
    """Diagnose the cases that are named, or all."""
    folder = Path(sys.argv[1] if sys.argv[1:] else CONFIG["data"])
    records = [resample_record(r, CONFIG["sample_time"])[0] for r in Dataset.from_bam(folder)]
    facts(folder, records)
    for name in sys.argv[2:] or CONFIG["cases"]:
        case, begin = CONFIG["cases"][name], time.process_time()
        found = diagnose(dataset(records, case), today(case), most=CONFIG["most"], seed=CONFIG["seed"])
        report(name, found, time.process_time() - begin)
        if "mass" in case:
            told(records, case)


main()
