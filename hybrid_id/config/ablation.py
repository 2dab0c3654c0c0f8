"""The section of a study file that says what `ablate` compares, and which wishes make no comparison."""

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from hybrid_id.config.sections import MOST_SEED, Distinct, Neurons, Positive, Section
from hybrid_id.parameters import MOST_STATES

MOST_REPEATS = 1000


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
