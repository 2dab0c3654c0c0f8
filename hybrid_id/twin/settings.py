"""What a twin of one rigid link is made of: machine, disturbances, experiments, and the model that users start from."""

from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, PositiveInt, ValidationInfo, field_validator

#: Parameters of the rigid link with asymmetric Stribeck friction, in the order of the paper's Table 2.
PARAMETERS = ("J", "P_m1", "P_m2", "f_11", "f_12", "f_13", "f_14", "f_21", "f_22", "f_23", "f_24", "f_3")

NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Section(BaseModel):
    """Base of the sections: frozen, and an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Truth(Section):
    """True parameters of the link, named as in Table 2 (SI units)."""

    J: PositiveFloat
    P_m1: PositiveFloat
    P_m2: NotNegative
    f_11: NotNegative
    f_12: NotNegative
    f_13: float
    f_14: PositiveFloat
    f_21: NotNegative
    f_22: NotNegative
    f_23: float
    f_24: PositiveFloat
    f_3: NotNegative


class Disturbances(Section):
    """Sizes of all that the identification's model does not know.

    Attributes:
        friction_drift: half-width of the uniform factors, one for each friction level and f_3, drawn once a run.
        torque_noise: std of the white random torque, held over a sample, as a fraction of f_11.
        encoder_counts: counts per motor turn.
        encoder_noise: std of the white noise before rounding to counts [rad].
        start_angle: half-width of the uniform start angle [rad, motor].
    """

    friction_drift: Annotated[float, Field(ge=0, lt=1)]
    torque_noise: NotNegative
    encoder_counts: PositiveInt
    encoder_noise: NotNegative
    start_angle: NotNegative

    @property
    def encoder_quantum(self) -> float:
        """Angle of one count [rad]."""
        return 2 * np.pi / self.encoder_counts

    @property
    def angle_noise(self) -> float:
        """Std of noise and rounding together [rad]."""
        return float(np.hypot(self.encoder_noise, self.encoder_quantum / np.sqrt(12)))


class Experiment(Section):
    """A multisine: band [Hz], number of tones, peak voltage [V], seed of its phases, and the role of its record."""

    band: tuple[PositiveFloat, PositiveFloat]
    tones: PositiveInt
    peak: PositiveFloat
    seed: int = 0
    role: Literal["train", "test"] = "train"


class Excitation(Section):
    """The experiments, and from how many phase sets the least crest factor is searched."""

    starts: PositiveInt
    experiments: Annotated[list[Experiment], Field(min_length=1)]


class Knowledge(Section):
    """What the user's model file says of one parameter; without a nominal it starts off the truth."""

    lower: float
    upper: float
    unit: str
    nominal: float | None = None
    prior_std: PositiveFloat | None = None


class Model(Section):
    """The model file that goes with the records."""

    start_error: Annotated[float, Field(ge=0, lt=1)]
    parameters: dict[str, Knowledge]

    @field_validator("parameters")
    @classmethod
    def _all_and_no_others(cls, parameters: dict[str, Knowledge]) -> dict[str, Knowledge]:
        if odd := set(parameters) ^ set(PARAMETERS):
            raise ValueError(f"must hold exactly {', '.join(PARAMETERS)}; see {', '.join(sorted(odd))}")
        return parameters


class LinkTwin(Section):
    """All settings of a twin; times in s, `rest` is part of `duration`."""

    name: str
    sample_time: PositiveFloat
    rest: NotNegative
    duration: PositiveFloat
    substeps: PositiveInt
    gear_ratio: PositiveFloat
    truth: Truth
    disturbances: Disturbances
    excitation: Excitation
    model: Model

    @field_validator("duration")
    @classmethod
    def _leaves_time_to_move(cls, duration: float, info: ValidationInfo) -> float:
        if duration < info.data.get("rest", 0.0) + 10 * info.data.get("sample_time", 0.0):
            raise ValueError("must be longer than rest by ten samples or more")
        return duration
