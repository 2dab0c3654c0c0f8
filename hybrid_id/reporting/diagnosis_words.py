"""A diagnosis in sentences: where, how far, what is not told apart, what the re-fit has bent."""

from __future__ import annotations

import math
from collections.abc import Sequence

from hybrid_id.diagnosis.locate import IN_WORDS, Location
from hybrid_id.diagnosis.probability import Suspect
from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.reporting.tables import count

LEAST_SHARE = 0.02
"""Share of the gap from which a place is worth naming."""
PLACES = {
    "input": "at the input", "motor": "in the motor", "motor_friction": "on the motor side",
    "transmission": "in the gear", "link_friction": "on the link side", "load": "at the load",
}  # fmt: skip
SIDES = {"motor": "motor side", "load": "link side"}


def goes_with(location: Location) -> str:
    """How the missing torque depends on its signal, in words."""
    if location.signal in IN_WORDS:
        return IN_WORDS[location.signal]
    steps = [b - a for a, b in zip(location.torque, location.torque[1:], strict=False)]
    rising = sum(step for step in steps if step > 0)
    falling = -sum(step for step in steps if step < 0)
    verb = "grows" if rising > 5 * falling else "falls" if falling > 5 * rising else "varies"
    return f"it {verb} with the {location.signal}"


def where_line(diagnosis: Diagnosis) -> str:
    """The sides of joints and the signals that explain most of what the re-fitted model leaves."""
    sides: dict[str, list[str]] = {}
    for one in [one for one in diagnosis.where if one.share > LEAST_SHARE][:3]:
        side = side_words(one.joint, one.place)
        signal = one.signal if one.signal.startswith("what") else f"the {one.signal}"
        sides.setdefault(side, []).append(f"{signal} ({percent(one.share)})")
    if not sides:
        return ""
    words = "; ".join(f"{side}, over {', '.join(signals)}" for side, signals in sides.items())
    return f"what the re-fitted model leaves (mean square) is explained by a torque at {words}."


def gap_line(diagnosis: Diagnosis) -> str:
    """Normalised errors on the test records, from today's model down to what the right one would leave."""
    if diagnosis.nominal is None or diagnosis.shrink is None:
        return "there is no test record with motion, so no unseen record says."
    gap, records = diagnosis.shrink, count(len(diagnosis.nominal.by_record), "test record")
    corrected = (
        f", corrected {error_words(gap.with_effect)}" if diagnosis.selected or diagnosis.varying else ""
    )
    window = diagnosis.search.window
    lost = f" Free runs lose these records: effects were compared over {window:g} s." if window else ""
    if diagnosis.halted:
        lost += " Free runs halt at another detent here; from measured states the model follows these records, too."
    if diagnosis.opened is not None:
        lost += f" Test record '{diagnosis.opened}' joined the train records, which show too little of it."
    return (
        f"normalised error on {records}: today's model {error_words(diagnosis.nominal.nrmse)}, re-fitted "
        f"{error_words(gap.refit)}{corrected}; the right model would leave {error_words(gap.floor)}.{lost}"
    )


def withdrawn_lines(diagnosis: Diagnosis) -> list[str]:
    """Effects that the test records have not borne out, as one line; none where there is none."""
    if not diagnosis.withdrawn:
        return []
    words = joined(list(diagnosis.withdrawn))
    verb = "lowers" if len(diagnosis.withdrawn) == 1 else "lower"
    return [
        f"withdrawn: {words} {verb} the errors of the train records, hardly or not surely those of the test records."
    ]


def varying_lines(diagnosis: Diagnosis) -> list[str]:
    """How parameters differ from record to record, as one line; none where one set explains all records."""
    if not diagnosis.varying:
        return []
    return [
        f"differ from record to record (standard deviation): {joined(list(diagnosis.varying))}. `identify` fits a set "
        "a record; a simulator is drawn from such sets, not from one."
    ]


def untold_lines(diagnosis: Diagnosis, most: int | None = None) -> list[str]:
    """Changes of parameters that these records do not see, then facts that change together, a line each."""
    return [f"not told: {words}." for words in (*diagnosis.untold[:most], *diagnosis.together[:most])]


def bent_lines(diagnosis: Diagnosis, most: int | None = None) -> list[str]:
    """Parameters that the re-fit has bent, as one line; none where there is none."""
    if not diagnosis.bent:
        return []
    shown = list(diagnosis.bent[:most])
    more = len(diagnosis.bent) - len(shown)
    words = ", ".join(shown) + (f" and {more} more" if more else "")
    why = "it may hide an effect" if not diagnosis.selected else "it hides the effect in them"
    return [f"bent: the re-fit moves parameters further than data sheets are wrong, so {why}: {words}."]


def values_of(diagnosis: Diagnosis, one: Suspect, reach: float) -> list[str]:
    """Its parameters as ``gap = 0.012 ± 0.0004 rad``."""
    units = _units(diagnosis, one)
    return [
        f"{symbol} = {_measured(value, reach * error, units.get(symbol, '1'))}"
        for symbol, (value, error) in one.parameters.items()
    ]


def words_of(name: str) -> str:
    """An effect's name as people write it."""
    return name.replace("_", " ")


def _units(diagnosis: Diagnosis, one: Suspect) -> dict[str, str]:
    name, joint = (one.name, one.where), one.where.split("/")[0]
    for found in (e for r in diagnosis.search.rounds for e in r.candidates if name in e.effects):
        before = diagnosis.search.base.system.components
        return {
            i.symbol: i.spec.unit
            for i in found.system.table
            if i.component.startswith(joint) and i.component not in before
        }
    return {}


def _measured(value: float, error: float, unit: str) -> str:
    sure = f" ± {error:.2g}" if math.isfinite(error) and error > 0 else ""
    return f"{value:.4g}{sure}{'' if unit == '1' else f' {unit}'}"


def joint_words(where: str) -> str:
    """``joint1/motor`` -> ``joint 1``."""
    return where.split("/")[0].replace("joint", "joint ")


def side_words(joint: str, place: str) -> str:
    """``joint1``, ``load`` -> ``joint 1, link side``; a joint whose sides move alike has none."""
    return f"{joint_words(joint)}, {SIDES[place]}" if place in SIDES else joint_words(joint)


def place_words(where: str) -> str:
    """``joint1/transmission`` -> ``in the gear``."""
    return PLACES.get(where.split("/")[-1], where)


def percent(share: float) -> str:
    """A share as it is printed."""
    return f"{100 * min(share, 1.0):.0f} %"


def goes(before: float, after: float) -> str:
    """How an error changes."""
    return f"{'falls' if after < before else 'rises'} from {error_words(before)} to {error_words(after)}"


def error_words(value: float) -> str:
    """An error as it is printed."""
    return f"{value:.3g}"


def joined(words: Sequence[str]) -> str:
    """A list as people say it."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def capital(words: str) -> str:
    """A sentence's start."""
    return words[:1].upper() + words[1:]
