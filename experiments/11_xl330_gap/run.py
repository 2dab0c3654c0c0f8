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
from hybrid_id.diagnosis.diagnose import diagnose
from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.parameters import Bounded
from hybrid_id.records.dataset import Channel
from hybrid_id.records.readers.bam import read_bam
from hybrid_id.records.record import Record
from hybrid_id.records.resample import resample_record
from hybrid_id.records.yaml_file import read_yaml
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
    gains, heat = [], []
    for file in sorted(folder.glob("*.json*")):
        columns = read_bam(file, ["gain1", "temperature1"]).columns
        gains.append(columns["gain1"][0])
        heat.append(columns["temperature1"].mean())
    print(f"gain and temperature of {len(gains)} records: correlation {np.corrcoef(gains, heat)[0, 1]:.2f}")
    for gain in sorted(set(gains)):
        some = [h for g, h in zip(gains, heat, strict=True) if g == gain]
        print(f"  gain {gain:.0f}: {min(some):.1f} to {max(some):.1f} degC")
    duty, supply, speed = (
        np.concatenate(part)
        for part in zip(
            *(
                (r.signal("duty1"), r.signal("supply1"), np.gradient(r.signal("q_m1"), r.time))
                for r in records
            ),
            strict=True,
        )
    )
    since = np.concatenate([time_at_full(r) for r in records])
    for low, high in ((0.0, 0.1), (0.3, 0.9), (0.995, 1.1)):
        some = supply[(np.abs(duty) >= low) & (np.abs(duty) < high)]
        print(f"supply at |duty| {low:g} to {high:g}: mean {some.mean():.2f} V, std {some.std():.2f} V")
    idle = supply[np.abs(duty) < 0.1].mean()
    for low, high in ((0.0, 0.1), (0.1, 0.5), (0.5, 3.0)):
        some = supply[(since >= low) & (since < high) & (np.abs(speed) < 0.3)]
        error = some.std() / len(some) ** 0.5
        print(
            f"stalled at full duty for {low:g} to {high:g} s: supply {idle - some.mean():.3f} +- {error:.3f} V lower"
        )


def time_at_full(record: Record) -> np.ndarray:
    """Time [s] since the duty has come to its limit, ``(T,)``; -1 where it is not there."""
    full = np.abs(record.signal("duty1")) >= 0.995
    first = np.flatnonzero(full & ~np.append(False, full[:-1]))
    last = np.searchsorted(first, np.arange(len(full)), side="right") - 1
    return np.where(full, record.time - record.time[first[np.maximum(last, 0)]] if len(first) else 0.0, -1.0)


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
    print(f"  bent: {'; '.join(found.bent) or 'nothing'}")
    print(
        f"  compared over {'whole records' if found.search.window is None else f'{found.search.window:g} s'}"
    )
    print(f"  withdrawn: {'; '.join(found.withdrawn) or 'nothing'}")
    print(f"  cannot be told: {'; '.join([*found.untold, *found.together])}", flush=True)
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


main()
