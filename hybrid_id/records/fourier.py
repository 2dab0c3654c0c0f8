"""The paper's preprocessing of records (section II.E): angles without the frequencies of their noise, and speeds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.derivatives import differentiate


def fourier(dataset: Dataset, band: tuple[float, float] | None = None, *, speeds: bool = False) -> Dataset:
    """Every record with its angles filtered by the discrete Fourier transform, and cut to where that holds.

    A record that is no whole number of periods loses its ends, where the filtered angle rings.

    Args:
        dataset: records of angles ``q_m1``, ``q_a1`` ..., uniform in time.
        band: lowest and highest frequency to keep [Hz]; None for all below the noise floor of each spectrum.
        speeds: whether the derivatives become outputs ``v_m1``, ``v_a1`` ... where no sensor has measured them. They
            say nothing that the angles do not: intervals of a fit of both are too narrow.

    Raises:
        InputError: a record is not uniform in time, too short, or cannot hold the band; its name is given.
    """
    angles = [channel for channel in dataset.outputs if channel.name.startswith("q_")]
    known = {channel.name for channel in dataset.outputs}
    found = [Channel(f"v{channel.name[1:]}", f"{channel.unit}/s") for channel in angles] if speeds else []
    added = tuple(channel for channel in found if channel.name not in known)
    new = {channel.name for channel in added}
    records = []
    for record in dataset.records:
        if not record.is_uniform:
            raise InputError(
                f"{record.title}: the Fourier transform needs uniform stamps; add 'resample: true'"
            )
        outputs, valid = dict(record.outputs), np.ones(record.n_samples, bool)
        for name in (channel.name for channel in angles):
            try:
                result = differentiate(record.outputs[name], record.sample_time, band=band)
            except InputError as error:
                raise InputError(f"{record.title}: {name}: {error}") from None
            outputs[name] = result.position
            if (speed := f"v{name[1:]}") in new:
                outputs[speed] = result.velocity
            valid &= result.valid
        kept = np.flatnonzero(valid)
        if len(kept) < 2:
            raise InputError(
                f"{record.title}: too short for the Fourier transform, which rings in all of it; leave it out"
            )
        first, last = (float(record.time[k]) for k in kept[[0, -1]])
        records.append(replace(record, outputs=outputs).between(first, last))
    return replace(dataset, outputs=(*dataset.outputs, *added), records=tuple(records))
