"""The cases: which records and model a diagnosis gets, and the answers that are right."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from real_machines import CONFIG, Machine, changed, dfki, emps_twin, pendulum, qube, with_tests, xl330

from hybrid_id import Record

CLAIM = 0.5
"""Probability from which a name counts as asserted."""


@dataclass(frozen=True)
class Case:
    """One question to a diagnosis.

    Attributes:
        build: records and model from the folder of the data.
        expected: answers that are right: names of the effect that comes first, or a verdict where none is named.
        size: of the expected effect: parameter, least and largest right value; empty where any will do.
        changes: pattern of the change of parameter values that has to be named, whatever else is; empty for none.
        window: length of the free runs [s] that nominal, re-fitted and corrected model are scored by; None for none.
    """

    build: Callable[[Path], Machine]
    expected: tuple[str, ...] = ()
    size: tuple[str, float, float] | tuple[()] = ()
    changes: str = ""
    window: float | None = None


def agreement(case: Case, answer: Mapping[str, Any]) -> str:
    """How an answer (``Diagnosis.as_dict()``) meets what is expected.

    ``right``, ``right, beside others`` (the change of values that was made is named, and effects that were not),
    ``right name, wrong size``, ``indistinguishable`` (the first name is not the right one, but is said to be
    indistinguishable from it), ``nothing named``, ``wrong below 0.5``, ``wrong``, or ``-`` where nothing definite is
    expected.
    """
    named = [effect for effect in answer["effects"] if effect.get("selected")]
    if case.changes and re.search(case.changes, answer["changes"], re.IGNORECASE):
        return "right, beside others" if named else "right"
    if not (case.expected or case.changes):
        return "-"
    if not named:
        return "right" if answer["verdict"] in case.expected else "nothing named"
    first = named[0]
    if first["name"] in case.expected:
        if not case.size:
            return "right"
        symbol, low, high = case.size
        value = next((v[0] for k, v in first["parameters"].items() if k.startswith(symbol)), np.nan)
        return "right" if low <= value <= high else "right name, wrong size"
    if any(other.split("@")[0] in case.expected for other in first.get("tied_with", ())):  # name@place
        return "indistinguishable"
    return "wrong" if first["probability"] >= CLAIM else f"wrong below {CLAIM:g}"


def half(machine: Machine, number: int) -> Machine:
    """A random half of the records trains, the other half tests."""
    count = len(machine.dataset)
    order = np.random.default_rng([CONFIG["seed"], number]).permutation(count)
    return with_tests(machine, order[count // 2 :].tolist())


def one_gain(data: Path, gain: float) -> Machine:
    """The four records of one gain of the servo."""
    machine, held_out = xl330(data), CONFIG["xl330"]["held_out"]
    four = tuple(record for record in machine.dataset if record.meta["gain1"] == gain)
    alone = replace(machine, dataset=replace(machine.dataset, records=four))
    return with_tests(alone, held_out)


def other_half(machine: Machine, number: int) -> Machine:
    """Every other record trains, from the first (1) or the second (2) on; the others test."""
    return with_tests(machine, range(len(machine.dataset))[number % 2 :: 2])


def heavier(machine: Machine, factor: float = 1.3) -> Machine:
    """The model's load, its inertia behind the gear and its weight, times a factor; the records stay."""
    J, share, G_l = (machine.system.parameter(name).spec.value for name in ("J", "rotor_share", "G_l"))
    more = J * (share + (1.0 - share) * factor)
    values = {"J": more, "rotor_share": share * J / more, "G_l": factor * G_l}
    return replace(machine, system=machine.system.with_values(values))


def late(machine: Machine, seconds: float = 0.03) -> Machine:
    """All inputs logged so much too early, as if the machine answered later; records end so much earlier."""

    def change(record: Record) -> Record:
        n = round(seconds / record.sample_time)
        inputs = {name: values[n:] for name, values in record.inputs.items()}
        outputs = {name: values[:-n] for name, values in record.outputs.items()}
        return replace(record, time=record.time[:-n], inputs=inputs, outputs=outputs)

    return changed(machine, change)


def biased(machine: Machine, channel: str, amount: float) -> Machine:
    """A constant added to a logged command."""
    return changed(
        machine,
        lambda record: replace(record, inputs={**record.inputs, channel: record.inputs[channel] + amount}),
    )


def known_xl330(data: Path) -> Machine:
    """The servo with load-dependent friction known, so that an intervention is the largest gap."""
    return half(xl330(data, "known"), 0)


def known_pendulum(data: Path) -> Machine:
    """The pendulum with values that were identified on it."""
    return pendulum(data, CONFIG["pendulum"]["known"])


def interventions(known: Callable[[Path], Machine], channel: str, bias: float) -> dict[str, Case]:
    """The three known changes of one machine."""
    return {
        "load_plus_30": Case(lambda data: heavier(known(data)), changes="the load is .* lighter"),
        "delay_30ms": Case(lambda data: late(known(data)), ("delay",), ("T_d", 0.02, 0.04)),
        "bias": Case(lambda data: biased(known(data), channel, bias), ("constant_torque",)),
    }


LOADED = ("load_dependent_friction",)
ASYMMETRIC = ("asymmetric_friction",)
CASES: dict[str, Case] = {
    **{f"xl330_half_{k}": Case(lambda data, k=k: half(xl330(data), k), LOADED) for k in range(10)},
    **{f"xl330_gain_{g}": Case(partial(one_gain, gain=g), LOADED) for g in (100, 400, 800)},
    **{
        f"dfki_{design.replace('.', '')}_{n}": Case(
            lambda data, design=design, n=n: other_half(dfki(data, design), n),
            window=CONFIG["dfki"]["window"],
        )
        for design in CONFIG["dfki"]["designs"]
        for n in (1, 2)
    },
    "qube": Case(lambda data: other_half(qube(data), 1), ("spring_load", "constant_torque")),
    "simple_pendulum": Case(pendulum),
    **{
        f"xl330_{what}": case
        for what, case in interventions(known_xl330, "duty1", CONFIG["xl330"]["bias"]).items()
    },
    **{
        f"pendulum_{what}": case
        for what, case in interventions(known_pendulum, "tau1", CONFIG["pendulum"]["bias"]).items()
    },
    "emps_twin": Case(partial(emps_twin, cut=False), ASYMMETRIC),
    "emps_twin_strokes": Case(partial(emps_twin, cut=True), ASYMMETRIC),
}
