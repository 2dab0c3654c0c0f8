"""Sections of the settings of a twin: disturbances, experiments, and the model that users start from."""

from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, PositiveInt

Number = Annotated[float, Field(allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Section(BaseModel):
    """Base of the sections: frozen, and an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Encoder(Section):
    """Counts per turn, and std of the white noise before rounding to counts [rad]."""

    counts: PositiveInt
    noise: NotNegative

    @property
    def quantum(self) -> float:
        """Angle of one count [rad]."""
        return 2 * np.pi / self.counts

    @property
    def angle_noise(self) -> float:
        """Std of noise and rounding together [rad]."""
        return float(np.hypot(self.noise, self.quantum / np.sqrt(12)))


class Ripple(Section):
    """Torque ripple of each motor: amplitude as a fraction of its f_11, and periods per turn."""

    share: NotNegative
    periods: PositiveInt


class Disturbances(Section):
    """Sizes of all that the identification's model does not know.

    Attributes:
        friction_drift: half-width of the uniform factors, one for each friction level and f_3, drawn once a run.
        torque_noise: std of the white random torque, held over a sample, as a fraction of the motor's f_11.
        torque_ripple: none where it is left out.
        encoder_counts: counts per motor turn.
        encoder_noise: std of the white noise before rounding to counts [rad].
        link_encoder: at the link of a flexible drive; none where it is left out.
        start_angle: half-width of the uniform start angle [rad, motor].
    """

    friction_drift: Annotated[float, Field(ge=0, lt=1)]
    torque_noise: NotNegative
    torque_ripple: Ripple | None = None
    encoder_counts: PositiveInt
    encoder_noise: NotNegative
    link_encoder: Encoder | None = None
    start_angle: NotNegative

    @property
    def encoder(self) -> Encoder:
        """The encoder of every motor."""
        return Encoder(counts=self.encoder_counts, noise=self.encoder_noise)


class Sines(Section):
    """A multisine: band [Hz], number of tones, peak voltage [V] and seed of its phases."""

    band: tuple[PositiveFloat, PositiveFloat]
    tones: PositiveInt
    peak: PositiveFloat
    seed: int = 0

    def __str__(self) -> str:
        return f"multisine {self.band[0]:g}-{self.band[1]:g} Hz, {self.peak:g} V"


class Experiment(Sines):
    """The multisine of a machine with one motor, and the role of its record."""

    role: Literal["train", "test"] = "train"

    @property
    def voltages(self) -> tuple[Sines | None, ...]:
        """One multisine for each motor."""
        return (self,)

    @property
    def pose(self) -> tuple[float, ...]:
        """Joint angles at the start [rad], before the random start angle."""
        return (0.0,)


class ArmExperiment(Section):
    """The multisines of both motors (none: no voltage), the joint angles at the start [rad], the role."""

    u1: Sines | None = None
    u2: Sines | None = None
    pose: tuple[Number, Number] = (0.0, 0.0)
    role: Literal["train", "test"] = "train"

    @property
    def voltages(self) -> tuple[Sines | None, ...]:
        """One multisine for each motor."""
        return (self.u1, self.u2)

    def __str__(self) -> str:
        return "; ".join(f"u{i} {sines}" for i, sines in enumerate(self.voltages, start=1) if sines)


class Excitation(Section):
    """The experiments, and from how many phase sets the least crest factor is searched."""

    starts: PositiveInt
    experiments: Annotated[list[Experiment], Field(min_length=1)]


class ArmExcitation(Section):
    """The same for two motors."""

    starts: PositiveInt
    experiments: Annotated[list[ArmExperiment], Field(min_length=1)]


class Knowledge(Section):
    """What the user's model file says of one parameter; without a nominal it starts off the truth.

    With `estimate` false it is held, but in the variant with priors only where it has no `prior_std`.
    """

    lower: float
    upper: float
    unit: str
    nominal: float | None = None
    estimate: bool = True
    prior_std: PositiveFloat | None = None


class Model(Section):
    """The model file that goes with the records."""

    start_error: Annotated[float, Field(ge=0, lt=1)]
    parameters: dict[str, Knowledge]
