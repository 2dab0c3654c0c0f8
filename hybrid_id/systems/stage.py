"""From one stage of an identification to the next: what was found goes on, and some of it is held."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from hybrid_id.errors import InputError
from hybrid_id.systems.chain import System


def carry_over(
    system: System, previous: System, hold: Sequence[str] = (), names: Mapping[str, str] | None = None
) -> System:
    """The system started at the values that an earlier stage found.

    Paper, sections III.D and IV: the flexible model of link 1 keeps the motor and viscous parameters of the rigid
    one, link 2 is identified with joint 1 held, and so on.

    Args:
        system: model of this stage.
        previous: identified model of the earlier stage.
        hold: names of parameters that keep the earlier value; this fit does not move them.
        names: what the earlier stage calls parameters of this model, where it calls them otherwise.

    Raises:
        InputError: a parameter to hold that one of the models lacks, a unit that differs, or a value outside this
            stage's bounds.
    """
    found = {info.name: info.spec for info in previous.table}
    found |= {here: found[there] for here, there in (names or {}).items() if there in found}
    own = {info.name: info.spec for info in system.table}
    for name in hold:
        if name not in found or name not in own:
            lacking = "earlier stage's model" if name not in found else "model"
            shared = ", ".join(n for n in own if n in found) or "none"
            raise InputError(f"The {lacking} has no parameter '{name}' to hold; both models have {shared}.")
    specs = {}
    for name in (n for n in own if n in found):
        if own[name].unit != found[name].unit:
            raise InputError(
                f"Parameter {name} is in {found[name].unit} in the earlier stage and in {own[name].unit} here; "
                "rename one of them."
            )
        specs[name] = own[name].at(found[name].value)
        if name in hold:
            specs[name] = replace(specs[name], estimate=False, prior_mean=None, prior_std=None)
    return system.with_specs(specs)
