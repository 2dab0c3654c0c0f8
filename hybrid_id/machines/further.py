"""Proposed experiments made on the machine of a case, which is drawn once more from what its answers tell."""

from collections.abc import Mapping, Sequence
from typing import Any

from hybrid_id.errors import InputError
from hybrid_id.machines.arms.case import SameArm, family_of
from hybrid_id.machines.case import NAME, further_record
from hybrid_id.machines.draw import same_case
from hybrid_id.machines.make import ARMS
from hybrid_id.records.record import Record


def further_records(
    case: str, experiments: Sequence[Mapping[str, Any]], sheet: Mapping[str, Any], options: Mapping[str, Any]
) -> list[Record]:
    """One record of each proposed experiment.

    Args:
        case: its name.
        experiments: ``joint``, ``command`` and ``sample_time`` of each; of an arm also the angles that are ``held`` and
            the ``start``, see :meth:`hybrid_id.machines.arms.case.SameArm.record`.
        sheet: answers of the case, with ``seed`` and ``draw`` that it was made from.
        options: with which all cases were made.

    Raises:
        InputError: the machine does not come out as its answers say.
    """
    source = sheet["made_by"]
    seed, draw = source["seed"], source["draw"]
    names = [NAME if k == 1 else f"{NAME}_{k}" for k in range(1, len(experiments) + 1)]
    if options.get("realism") == ARMS:
        effect = options["effect"]
        arm = SameArm(seed, draw, family_of(seed, options["family"], effect), effect)
        _check(case, sheet, arm.engine, arm.formulas, arm.sizes)
        return [
            arm.record(one, name, seed=seed + 1000 * k)
            for k, (one, name) in enumerate(zip(experiments, names, strict=True))
        ]
    machine = same_case(seed, draw, name=case, **options)
    formulas = [type(effect).__name__ for effect in machine.effects]
    _check(case, sheet, machine.engine, formulas, [effect.size() for effect in machine.effects])
    return [
        further_record(
            machine, one["joint"], one["command"], one["sample_time"], seed=seed + 1000 * k, name=name
        )
        for k, (one, name) in enumerate(zip(experiments, names, strict=True))
    ]


def _check(
    case: str,
    sheet: Mapping[str, Any],
    engine: str,
    formulas: Sequence[str],
    sizes: Sequence[Mapping[str, float]],
) -> None:
    """Refuse a machine that is not the one of the answers."""
    source, known = sheet["made_by"], [effect["size"] for effect in sheet["effects"]]
    other = any(
        source.get(key, value) != value for key, value in (("engine", engine), ("formulas", list(formulas)))
    )
    if other or list(sizes) != known[: len(sizes)]:
        raise InputError(
            f"case {case} cannot be made again here as its answers say ({source['engine']}, "
            f"{', '.join(source['formulas'])}, their sizes); install MuJoCo, and take the version that made the cases"
        )
