"""SO-101: four inputs of `diagnose` in each of which one known thing differs between records and model, sealed."""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import secrets
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import so101
from halves import nominal
from run import fit_joint
from sets import CARRIES_NOTHING, moving

from hybrid_id.components import Delay
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.record import Record
from hybrid_id.records.yaml_file import write_yaml
from hybrid_id.systems.model_file import describe_model

KINDS = ("payload", "delay", "zero", "gain")
NONE = "none"
"""Nothing is changed: what the real arm lacks is all that a diagnosis can find."""
LETTERS = "ABCD"
MJCF = "so101_new_calib.xml"
CARRIED = ("gripper", "moving_jaw_so101_v1")
"""Bodies that the wrist carries."""
HEAVIER, LATE, TURNED, STIFFER = 1.3, 0.03, np.deg2rad(3.0), 2.0
"""Payload in the model over the machine's; dead time [s]; zero [rad]; k_p in the model over the machine's."""
TRAIN, TEST = 6, 3
"""Motions of each role."""
SEEN = 2.0
"""Counts of the encoder by which a goal has to change within the dead time (RMS) at a joint that is delayed."""

PROBABLE = 0.1
"""Probability from which an effect is printed."""


def widest(dataset: Dataset, count: int) -> list[Record]:
    """The motions with the largest ranges of their goals, summed over the five joints."""
    return sorted(dataset.records, key=lambda r: -sum(float(np.ptp(v)) for v in r.inputs.values()))[:count]


def motions(folder: Path) -> Dataset:
    """The widest train motions, and as test records the widest of those that were kept away."""
    train, kept = (so101.load(folder, role)[role] for role in ("train", "aside"))
    test = [replace(record, role="test") for record in widest(kept, TEST)]
    return replace(train, records=(*widest(train, TRAIN), *test))


def identified(folder: Path, file: Path) -> dict[str, float]:
    """Values of the nominal model: each joint fitted by itself to the 15 train motions, unchanged; kept in a file."""
    if not file.exists():
        system, data, values = nominal(folder), so101.load(folder, "train")["train"], dict[str, float]()
        for k, joint in enumerate(so101.JOINTS):
            best, cost = fit_joint(system, data, k)
            own = {i.name: i.spec.value for i in best.table if i.spec.estimate}
            print(
                f"{joint}, cost {cost:.0f}: " + ", ".join(f"{n} {v:.4g}" for n, v in own.items()), flush=True
            )
            values |= own
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(values, indent=1))
    return json.loads(file.read_text())


def joints_for(kind: str, data: Dataset) -> list[str]:
    """Joints at which a change of a kind is meaningful; of a payload, which acts on all, none.

    A zero shows at any joint. A delay shows where the goal changes within it by more than the encoder's resolution,
    a gain where gravity gives the torques a scale, so that k_p is estimated.
    """
    if kind in ("payload", NONE):
        return []
    if kind == "gain":
        return [joint for joint in so101.JOINTS if joint not in CARRIES_NOTHING]
    if kind == "zero":
        return list(so101.JOINTS)
    return [joint for k, joint in enumerate(so101.JOINTS) if _within_delay(data, k) >= SEEN * so101.COUNT]


def _within_delay(data: Dataset, joint: int) -> float:
    """How far the goal of a joint changes within the delay [rad], RMS over the train motions in which it moves."""
    train, name = replace(data, records=data.train), f"goal{joint + 1}"
    steps = [earlier(r.time, r.inputs[name]) - r.inputs[name] for r in moving(train, joint).records]
    return float(np.sqrt(np.mean(np.concatenate(steps) ** 2)))


def earlier(time: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """A goal as it would be logged if the machine acted ``LATE`` after it: ``g'(t) = g(t + LATE)``, ``(T,)``.

    Between samples by straight lines, after the last one held.
    """
    return np.interp(time + LATE, time, goal)


def changed(record: Record, kind: str, joint: str) -> Record:
    """A record with the goal or the angle of a joint changed, where the kind says so."""
    number = so101.JOINTS.index(joint) + 1 if joint else 0
    if kind == "delay":
        goal = earlier(record.time, record.inputs[f"goal{number}"])
        return replace(record, inputs={**record.inputs, f"goal{number}": goal})
    if kind == "zero":
        angle = record.outputs[f"q_a{number}"] + TURNED
        return replace(record, outputs={**record.outputs, f"q_a{number}": angle})
    return record


def heavier(text: str) -> str:
    """The MJCF with what the wrist carries heavier: mass and inertia, as of denser bodies."""
    for body in CARRIED:
        found = re.search(rf'<body name="{body}".*?<inertial [^>]*>', text, re.DOTALL)
        assert found is not None, body
        own = re.sub(
            r'(mass|fullinertia)="([^"]*)"(?=[^<]*$)',
            lambda one: f'{one[1]}="{" ".join(f"{HEAVIER * float(v):.6g}" for v in one[2].split())}"',
            found[0],
        )
        text = text.replace(found[0], own)
    return text


def write(folder: Path, source: Path, data: Dataset, values: dict[str, float], kind: str, joint: str) -> None:
    """A complete input of `diagnose`: records, MJCF and model, of which one thing is changed."""
    records = tuple(changed(record, kind, joint) for record in data.records)
    replace(data, records=records).save(folder)
    text = (source / MJCF).read_text()
    (folder / MJCF).write_text(heavier(text) if kind == "payload" else text)
    gain = {f"k_p_{joint}": STIFFER * values[f"k_p_{joint}"]} if kind == "gain" else {}
    content = describe_model(nominal(folder).with_values(values | gain), folder)
    content["components"] = [one for one in content["components"] if not _without_effect(one)]
    write_yaml(folder / "model.yaml", content)


def _without_effect(part: dict[str, Any]) -> bool:
    """Whether a part of the model is a delay that the fit has put at 0, which nobody would list."""
    return part["kind"] == Delay.kind and part["parameters"]["T_d"]["nominal"] == 0.0


def seal(wish: argparse.Namespace, data: Dataset, values: dict[str, float]) -> None:
    """Four folders in random order, joints drawn; the answers to a file that nobody looks at before naming."""
    draw = secrets.SystemRandom()
    kinds, answers = draw.sample(KINDS, len(KINDS)), dict[str, Any]()
    for letter, kind in zip(LETTERS, kinds, strict=True):
        able = joints_for(kind, data)
        joint = draw.choice(able) if able else ""
        write(wish.out / letter, wish.data, data, values, kind, joint)
        answers[letter] = {"kind": kind, "joint": joint}
    text = json.dumps(answers | {"salt": secrets.token_hex(16)})
    wish.sealed.write_text(text)
    print(f"sealed; SHA-256 of the answers {hashlib.sha256(text.encode()).hexdigest()}")


def said(file: Path) -> list[str]:
    """What a diagnosis says of each joint, a line each: effects from a probability of 0.1, parameters that moved."""
    lines = list[str]()
    for joint, found in json.loads(file.read_text())["joints"].items():
        lines.append(f"{joint}: {found['verdict']}")
        for one in found["effects"]:
            if one["probability"] >= PROBABLE:
                sizes = ", ".join(f"{name} {value:.4g}" for name, (value, _) in one["parameters"].items())
                mark = "asserted" if one["selected"] else "not asserted"
                lines.append(f"  {one['name']} at {one['where']}, {one['probability']:.2f}, {mark}: {sizes}")
        lines += [f"  {words}" for words in (found["changes"], *found["implausible_parameters"]) if words]
    return lines


def open_answers(results: Path, sealed: Path) -> None:
    """Print each answer beside the diagnoses in ``results/LETTER*/diagnosis.json``."""
    answers = json.loads(sealed.read_text())
    for letter in LETTERS:
        one = answers[letter]
        print(f"{letter}: {one['kind']} {one['joint']}")
        for file in sorted(results.glob(f"{letter}*/diagnosis.json")):
            print("\n".join(f"  {line}" for line in said(file)))


def main() -> None:
    """Make the four folders, or one of a kind that is asked for, or open the answers."""
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--data", type=Path, default=Path("../shared/data/so101"))
    ask.add_argument("--out", type=Path, default=Path("runs/18_so101/interventions"))
    ask.add_argument("--fit", type=Path, default=Path("runs/18_so101/interventions_fit.json"))
    ask.add_argument("--sealed", type=Path, default=Path("runs/18_so101/interventions_sealed.json"))
    ask.add_argument(
        "--kind", choices=(*KINDS, NONE), help="one folder, unsealed, of this kind: --out names it"
    )
    ask.add_argument("--joint", choices=so101.JOINTS, default="")
    ask.add_argument("--open", type=Path, metavar="RESULTS", help="print the answers beside these diagnoses")
    wish = ask.parse_args()
    if wish.open:
        open_answers(wish.open, wish.sealed)
        return
    values, data = identified(wish.data, wish.fit), motions(wish.data)
    if wish.kind is None:
        seal(wish, data, values)
    elif wish.joint and wish.joint not in (able := joints_for(wish.kind, data)):
        ask.error(
            f"--joint {wish.joint}: a change of kind {wish.kind} acts at {', '.join(able) or 'no joint'}"
        )
    else:
        write(wish.out, wish.data, data, values, wish.kind, wish.joint)


if __name__ == "__main__":
    main()
