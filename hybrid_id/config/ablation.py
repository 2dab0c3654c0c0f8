"""The section of a study file that says what `ablate` compares, and which wishes make no comparison."""

from typing import Any, Literal

from pydantic import Field, field_validator

from hybrid_id.config.sections import MOST_SEED, Neurons, Positive, Section
from hybrid_id.parameters import MOST_STATES

MOST_REPEATS = 1000


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
    place: list[str | list[str]] | None = Field(default=None, min_length=1)
    width: list[Neurons] | None = Field(default=None, min_length=1)
    reads: list[Literal["own", "all"]] = Field(default=["own"], min_length=1)
    physics: list[list[str]] = Field(default=[])
    memory: int = Field(default=2, ge=1, le=MOST_STATES)
    black_box_width: Neurons = 16
    seeds: int | list[int] = 5
    validation: float = Field(default=0.2, gt=0, lt=1)
    test: float = Field(default=0.2, gt=0, lt=1)
    out_of_range: list[str] = Field(default=[])
    horizon: Positive = 0.2

    @field_validator("seeds", mode="before")
    @classmethod
    def _repeats(cls, value: Any) -> Any:
        """One sentence for all faults, where a union of types has one for each type."""
        if _whole(value):
            if not 1 <= value <= MOST_REPEATS:
                raise ValueError(f"give from 1 to {MOST_REPEATS} repeats, or a list of seeds")
            return value
        if not isinstance(value, list) or not value or not all(map(_whole, value)):
            raise ValueError("give a whole number of repeats, or a list of at least one seed")
        if min(value) < 0:
            raise ValueError("seeds are not negative")
        if max(value) > MOST_SEED:
            raise ValueError(f"seeds are at most {MOST_SEED}")
        if len(value) > MOST_REPEATS:
            raise ValueError(f"give at most {MOST_REPEATS} seeds")
        return _distinct(value)

    @field_validator("place", mode="before")
    @classmethod
    def _places(cls, value: Any) -> Any:
        if value is None:
            return None
        if not isinstance(value, list) or not value:
            raise ValueError("give a list of at least one place")
        for place in value:
            several = place if isinstance(place, list) else [place]
            if not several or not all(isinstance(name, str) for name in several):
                raise ValueError("each place is a name, or a list of at least one name")
            _distinct(several)
        _distinct([place if isinstance(place, list) else [place] for place in value])
        return value

    @field_validator("width", "reads")
    @classmethod
    def _once(cls, value: list[Any] | None) -> list[Any] | None:
        return value if value is None else _distinct(value)


def _whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _distinct(values: list[Any]) -> list[Any]:
    """The values as they are; a ValueError where one is there twice."""
    for k, value in enumerate(values):
        if value in values[:k]:
            raise ValueError(f"{value} is given twice; keep one of them")
    return values
