"""All settings of a twin, by kind of machine."""

import difflib
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import PositiveFloat, PositiveInt, ValidationInfo, field_validator

from hybrid_id.errors import InputError
from hybrid_id.records.yaml_file import validate
from hybrid_id.twin.machines import ONE_LINK, ONE_LINK_FLEXIBLE, PEAK_SPEEDS, POSITIVE, Machine, two_link
from hybrid_id.twin.sections import (
    ArmExcitation,
    Disturbances,
    Excitation,
    Model,
    NotNegative,
    Number,
    Section,
)

#: Parameters of the rigid link with asymmetric Stribeck friction, in the order of the paper's Table 2.
PARAMETERS = ONE_LINK.parameters

#: What messages call the settings.
SOURCE = "settings of the twin"


class Twin(Section):
    """All settings of a twin; times in s, `rest` is part of `duration`."""

    name: str
    machine: str = "one_link"
    sample_time: PositiveFloat
    rest: NotNegative
    duration: PositiveFloat
    substeps: PositiveInt
    gear_ratio: Any
    truth: dict[str, Number]
    disturbances: Disturbances
    excitation: Any
    model: Model

    kind: ClassVar[Machine]

    @property
    def simulated(self) -> Machine:
        """The machine that makes the records."""
        return self.kind

    @property
    def gear_ratios(self) -> tuple[float, ...]:
        """One for each motor."""
        return tuple(np.atleast_1d(self.gear_ratio).tolist())

    @field_validator("duration")
    @classmethod
    def _leaves_time_to_move(cls, duration: float, info: ValidationInfo) -> float:
        if duration < info.data.get("rest", 0.0) + 10 * info.data.get("sample_time", 0.0):
            raise ValueError("must be longer than rest by ten samples or more")
        return duration

    @field_validator("truth")
    @classmethod
    def _can_be(cls, truth: dict[str, float]) -> dict[str, float]:
        _check_names("truth", truth, cls.kind.parameters)
        for name, value in truth.items():
            symbol = cls.kind.symbol(name)
            if (value < 0 and symbol not in PEAK_SPEEDS) or (value == 0 and symbol in POSITIVE):
                least = "must be positive" if symbol in POSITIVE else "must not be negative"
                raise InputError(f"{SOURCE}: key 'truth.{name}' is {value:g} and {least}; correct it")
        return truth

    @field_validator("model")
    @classmethod
    def _knows_all(cls, model: Model) -> Model:
        _check_names("model.parameters", model.parameters, cls.kind.parameters)
        return model

    @field_validator("disturbances")
    @classmethod
    def _has_a_link_to_measure(cls, disturbances: Disturbances) -> Disturbances:
        if disturbances.link_encoder and "q_a1" not in cls.kind.rows:
            raise InputError(
                f"{SOURCE}: key 'disturbances.link_encoder' needs a link that moves apart from its motor; remove it, "
                "or let machine be one_link_flexible"
            )
        return disturbances


class LinkTwin(Twin):
    """One rigid link."""

    kind = ONE_LINK
    gear_ratio: PositiveFloat
    excitation: Excitation


class FlexibleTwin(LinkTwin):
    """One link behind a gear with play and flexibility."""

    kind = ONE_LINK_FLEXIBLE


class ArmTwin(Twin):
    """Two links, one of whose joints may be held."""

    kind = two_link()
    gear_ratio: tuple[PositiveFloat, PositiveFloat]
    held: Literal[1, 2] | None = None
    excitation: ArmExcitation

    @property
    def simulated(self) -> Machine:
        """The machine that makes the records."""
        return two_link(self.held)

    @field_validator("truth")
    @classmethod
    def _has_mass(cls, truth: dict[str, float]) -> dict[str, float]:
        p_1, p_2, p_3, p_4 = (truth[f"P_{i}"] for i in (1, 2, 3, 4))
        # the determinant of the mass matrix is concave in cos q_2: its least value lies at an end
        if min((p_1 + 2 * c * p_3) * p_2 - (p_4 + c * p_3) ** 2 for c in (-1.0, 1.0)) <= 0:
            raise InputError(
                f"{SOURCE}: keys 'truth.P_1' to 'truth.P_4' give a mass matrix that is not positive definite at "
                "some q_2; lower P_3 or P_4, or raise P_1 or P_2"
            )
        return truth


TWINS: dict[str, type[Twin]] = {twin.kind.system: twin for twin in (LinkTwin, FlexibleTwin, ArmTwin)}


def read_settings(config: Mapping[str, Any]) -> Twin:
    """Check the settings of a twin; the first fault is an InputError that names its key."""
    machine = config.get("machine", "one_link")
    if not isinstance(machine, str) or machine not in TWINS:
        raise InputError(f"{SOURCE}: key 'machine' is {machine!r}; use one of {', '.join(TWINS)}")
    return validate(TWINS[machine], config, SOURCE)


def _check_names(section: str, given: Iterable[str], names: tuple[str, ...]) -> None:
    """Refuse a section that does not name each parameter of the machine, and nothing else."""
    given = list(given)
    for name in given:
        if name not in names:
            close = difflib.get_close_matches(name, names, n=1)
            hint = f"did you mean '{close[0]}'?" if close else "remove it"
            raise InputError(f"{SOURCE}: key '{section}.{name}' is unknown; {hint}")
    for name in names:
        if name not in given:
            raise InputError(f"{SOURCE}: key '{section}.{name}' is missing; add it")
