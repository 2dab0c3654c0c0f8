"""The sections of a study file, with all their defaults."""

from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, field_validator

from hybrid_id.parameters import MOST_LAYERS, MOST_NEURONS, MOST_STATES
from hybrid_id.records.schema import ResampleEntry
from hybrid_id.records.yaml_file import FilePath

MOST_SEED = 2**32 - 1  # what every generator of random numbers takes
MOST_STARTS, MOST_JOBS, MOST_EFFECTS, MOST_REPEATS = 10_000, 1000, 100, 1000
"""What a command may be asked for at most: start points, processes, effects, repeats."""
SMALLEST, LARGEST = 1e-12, 1e12
"""Of a quantity that a study file gives, in its unit; beyond them squares are lost, or nothing ends."""

Count = Annotated[int, Field(ge=1, le=1_000_000)]
"""Iterations, and what is counted in them."""
Starts = Annotated[int, Field(ge=1, le=MOST_STARTS)]
Jobs = Annotated[int, Field(ge=1, le=MOST_JOBS)]
Effects = Annotated[int, Field(ge=1, le=MOST_EFFECTS)]
Substeps = Annotated[int, Field(ge=1, le=10_000)]
"""Steps of integration a sample."""
Neurons = Annotated[int, Field(ge=1, le=MOST_NEURONS)]
States = Annotated[int, Field(ge=0, le=MOST_STATES)]
"""Hidden states of a network."""
Positive = Annotated[float, Field(ge=SMALLEST, le=LARGEST)]
Price = Annotated[float, Field(ge=0, le=LARGEST)]
Stages = Annotated[list[tuple[Positive, Count]], Field(max_length=100)]
"""Stages before the whole records, each (length of a window [s], use one window in this many)."""


Item = TypeVar("Item")


def _distinct(values: list[Any]) -> list[Any]:
    """The values as they are; a ValueError where one is there twice."""
    for k, value in enumerate(values):
        if value in values[:k]:
            raise ValueError(f"{value} is given twice; keep one of them")
    return values


Distinct = Annotated[list[Item], Field(min_length=1), AfterValidator(_distinct)]


def _seeds(value: Any) -> Any:
    """A number of repeats stands for the first seeds."""
    if not isinstance(value, int) or isinstance(value, bool):
        return value
    if not 1 <= value <= MOST_REPEATS:
        raise ValueError(f"give from 1 to {MOST_REPEATS} repeats, or a list of seeds")
    return list(range(value))


Places = Annotated[
    Distinct[str],
    BeforeValidator(lambda value: [value] if isinstance(value, str) else value, str | list[str]),
]
Seeds = Annotated[
    Distinct[Annotated[int, Field(ge=0, le=MOST_SEED)]],
    Field(max_length=MOST_REPEATS),
    BeforeValidator(_seeds, int | list[int]),
]


class Section(BaseModel):
    """A part of a study file; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Fourier(Section):
    """Angles without the frequencies of their noise (paper, section II.E).

    Attributes:
        band: lowest and highest frequency to keep [Hz]; all below the noise floor where it is left out.
        speeds: whether their derivatives become outputs, too.
    """

    band: tuple[float, float] | None = None
    speeds: bool = False


class Preprocessing(Section):
    """What is done to the records before anything else.

    Attributes:
        records: names of the records to use; all where it is left out.
        between: only the samples stamped between these two [s].
        resample: bring jittered stamps to a uniform grid.
        fourier: filter the angles by the discrete Fourier transform.
        signal_share: standard deviation added to each measurement's noise, as a share of the record's own.
    """

    records: list[str] | None = Field(default=None, min_length=1)
    between: tuple[float, float] | None = None
    resample: ResampleEntry | None = None
    fourier: Fourier | None = None
    signal_share: float = Field(default=0.004, ge=0, lt=1)


class Previous(Section):
    """An earlier stage, whose identified values this one starts from.

    Attributes:
        model: the model file that the earlier stage has written.
        hold: names of parameters that keep the earlier value and are not estimated again.
    """

    model: FilePath
    hold: list[str] = []


class Identification(Section):
    """How the parameters are found.

    Attributes:
        pooled: one set over all train records instead of one a record.
        loss: of the weighted residuals; `huber` and `l1` tolerate spikes.
        threshold: weighted residual from which `huber` grows linearly.
        starts: start points; the best end counts.
        max_iterations, tolerance: of the fit; converged when a step is under `tolerance` standard errors.
        friction: `dry` (the joint really stops), or `smooth` (tanh).
        substeps: least number of integration steps a sample; stability may ask for more.
        width: smoothing speed of `smooth` [rad/s].
        window: length [s] of the free runs that are fitted and compared with the records, `whole` records, `strokes`
            from rest to rest, or `auto`: whole records where the free runs follow them.
        seed: of start points and bootstrap.
        device: `cpu` or `cuda`.
    """

    pooled: bool = False
    loss: Literal["l2", "huber", "l1"] = "l2"
    threshold: Positive = 3.0
    starts: Starts = 1
    max_iterations: Count = 200
    tolerance: Positive = 0.01
    friction: Literal["dry", "smooth"] = "dry"
    substeps: Substeps = 1
    width: Positive = 0.5
    window: Positive | Literal["whole", "strokes", "auto"] = "auto"
    seed: int = Field(default=0, ge=0, le=MOST_SEED)
    device: str = "cpu"


class Training(Section):
    """How `train` finds them by the adjoint method; pooled, loss, threshold and seed are those of the identification.

    Attributes:
        method: torchdiffeq's solver, rk4 or dopri5 say.
        gradient: `adjoint`, or `backprop` through the steps.
        substeps, fine: least number of steps a sample, and of a sample in which a speed comes near zero.
        width: speed over which friction is smoothed [rad/s]; the smaller, the nearer to dry friction, and the slower.
        windows: stages before the whole records, each (length of a window [s], use one window in this many).
        max_iterations, tolerance: of each stage; converged when a step is under `tolerance` standard errors.
        validate_every: gradients between two looks at the test records.
    """

    method: str = "rk4"
    gradient: Literal["adjoint", "backprop"] = "adjoint"
    substeps: Substeps = 1
    fine: Substeps = 32
    width: Positive = 0.05
    windows: Stages = [(0.2, 4)]
    max_iterations: Count = 100
    tolerance: Positive = 0.01
    validate_every: Count = 5


class Network(Section):
    """One residual network: see `hybrid_id.components.ResidualNetwork`.

    Attributes:
        place: where it acts, `joint1/motor`.
        inputs: names of its signals (`hybrid_id.systems.networks.Networks` lists them).
        hidden: neurons of each hidden layer.
        memory: hidden states; 0 for none.
        lipschitz: bound of its steepness in scaled inputs and output; none where it is left out.
    """

    place: str = "joint1/motor"
    inputs: list[str] = Field(default=["speed", "angle"], min_length=1)
    hidden: list[Neurons] = Field(default=[8], max_length=MOST_LAYERS)
    memory: States = 0
    lipschitz: Positive | None = None


class Hybrid(Section):
    """How `train` trains physics with networks; solver, gradient and width are those of `training`.

    Attributes:
        networks: what is added to the model; none where the model file has its own.
        price: of the networks' mean square output, so that they add only what the physics cannot say.
        windows: stages in which the networks alone train, before the whole records, as in `training`.
        max_iterations, tolerance: of each stage.
        patience, validate_every: looks at the validation records without a gain that end a stage; gradients between.
        worth: share by which the networks have to lower the validation loss to be kept.
        optimizer: `gauss_newton`, or `adam` for networks of more than some hundred weights.
        rate, clip: of Adam: largest step of an unknown, and length to which gradients are clipped (Gauss-Newton's steps
            are damped instead).
        validation: names of the records that validate; by default the last fifth of the train records, and with one
            train record the test records.
    """

    networks: list[Network] = Field(default=[Network()], max_length=100)
    price: Price = 1.0
    windows: Stages = [(0.1, 4), (0.4, 2), (1.6, 1)]
    max_iterations: Count = 40
    tolerance: Positive = 0.1
    patience: Count = 10
    validate_every: Count = 2
    worth: float = Field(default=0.02, ge=0, lt=1)
    optimizer: Literal["gauss_newton", "adam"] = "gauss_newton"
    rate: Positive = 0.01
    clip: Positive = 1.0
    validation: Distinct[str] | None = None

    @field_validator("networks")
    @classmethod
    def _one_a_place(cls, networks: list[Network]) -> list[Network]:
        places = [network.place for network in networks]
        if len(set(places)) < len(places):
            raise ValueError("a place takes one network, and two are given for the same; leave one out")
        return networks


class Ablation(Section):
    """What `ablate` compares; solver and stages are those of `training` and `hybrid`.

    What the networks read, and their bound, are those of the first network of `hybrid`, as are `place` and
    `width` where they are left out. Every combination is an arm, each with the same records and seeds.

    Attributes:
        residual: kinds of networks beside the physics; `none` is always there, `black_box` is a network alone.
        place: where they act; a list in the list puts one network in each of its places.
        width: neurons of the hidden layer.
        reads: `own`: a network reads its own joint's signals; `all`: angle and speed of every other joint, too.
        physics: what is taken out on purpose, one list an arm: components by place and kind, parameters by name.
        memory: hidden states of a network with memory.
        black_box_width: neurons of the network that stands alone.
        seeds: repeats, or their seeds; each draws its records and the networks' first weights.
        validation, test: shares of the train records that are drawn to validate and to test; where there are records of
            role test, these test in every repeat instead.
        out_of_range: patterns of names or notes of records that no arm trains on, tested apart.
        horizon: length of the short free runs beside the whole records [s].
    """

    residual: list[Literal["none", "static", "memory", "black_box"]] = Field(
        default=["static", "memory", "black_box"]
    )
    place: Distinct[Places] | None = None
    width: Distinct[Neurons] | None = None
    reads: Distinct[Literal["own", "all"]] = Field(default=["own"])
    physics: list[list[str]] = Field(default=[])
    memory: int = Field(default=2, ge=1, le=MOST_STATES)
    black_box_width: Neurons = 16
    seeds: Seeds = Field(default=list(range(5)))
    validation: float = Field(default=0.2, gt=0, lt=1)
    test: float = Field(default=0.2, gt=0, lt=1)
    out_of_range: list[str] = Field(default=[])
    horizon: Positive = 0.2


class Gap(Section):
    """How `diagnose` searches; the seed is that of the identification.

    Attributes:
        max_effects: effects at most.
        jobs: processes that share the fits; None for one on each core, up to four, and one alone where the records are
            so long that each would need a gigabyte.
    """

    max_effects: Effects = 3
    jobs: Jobs | None = None


class Statistics(Section):
    """What is said about the parameters.

    Attributes:
        level: confidence of the intervals.
        profile: names of parameters whose interval `identify` finds by fits of all others, symmetric or not.
    """

    level: float = Field(default=0.95, gt=0, lt=1)
    profile: list[str] = []


class Output(Section):
    """Where the results go, and which.

    Attributes:
        folder: of the results; `--out` stands in for it.
        figures: PNG pictures.
        tensorboard: event files.
        report: everything on one page, report.html.
    """

    folder: FilePath | None = None
    figures: bool = True
    tensorboard: bool = True
    report: bool = True
