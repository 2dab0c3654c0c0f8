"""Some of the lanes of a batch, where only those need work."""

from __future__ import annotations

from torch import Tensor

from hybrid_id.systems.chain import Channels, Views


class LaneSubset:
    """A subset of lanes: takes it from rows of length B and leaves rows of length 1 as they are."""

    def __init__(self, lanes: Tensor, count: int) -> None:
        self.lanes, self.count = lanes, count

    def take(self, row: Tensor) -> Tensor:
        """The subset of a row."""
        return row if row.shape[-1] != self.count else row.index_select(-1, self.lanes)

    def take_all(self, u: Channels) -> Channels:
        """The subset of every channel."""
        return {name: self.take(channel) for name, channel in u.items()}

    def take_views(self, p: Views) -> Views:
        """The subset of every parameter."""
        return {key: type(v)(**self.take_all(vars(v))) for key, v in p.items()}
