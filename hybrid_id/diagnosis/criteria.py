"""The numbers that decide what a diagnosis claims, with their meaning and source.

Numbers that decide what is computed (which fits, iterations, draws, the length of blocks, initial values) stand beside
the code that uses them, and so do those of what is said beside the verdict: of parameters that are implausible
(``plausibility.py``), or have changed physically (``changes.py``).
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Criteria:
    """What has to be shown before something is claimed. Mean squares are of weighted errors on records left out.

    Attributes:
        false_alarms: probability that a search over the whole catalogue names anything where nothing is missing; level
            of the sign-flip test over all candidates of a selection step.
        wrong_names: the same level where a model leaves structure, so that something is missing for sure: few records
            that go together have little power.
        least_fall: smallest relative fall of the mean square for which a first effect is named that takes most of what
            neighbouring samples have in common; a law's formula differs between authors by about as much.
        next_fall: the same beside another effect, whose own formula may leave what a further one can pick up.
        completing_fall: the same for any other first effect; and beside another effect where what then remains is
            white.
        distinct_fall: relative difference of the mean squares of two candidates below which these are
            indistinguishable, and
        distinct_z: standard errors of their difference below which they are, too.
        major_share: share of what the best explains that a simpler candidate has to explain to lead in its place, where
            both leave structure that the records do not surely distinguish.
        autocorrelation_left: share of the autocorrelation that a small first effect may leave.
        left_open: share of the gap that a candidate may leave open, which another closes, and still be its rival; and
            of what the best leaves over whole records that one may leave over short runs for these to be taken.
        substantial: least share of the gap that a remainder has where something outside the catalogue is claimed, and
            that a torque has to explain of what remains to be named in the headline.
        white: share of the mean square in common with neighbouring samples (von Neumann's ratio) up to which
            residuals are white noise.
        coloured: the same from which something structural is missing; small random torques and the rounding of
            encoders alone leave less.
        negligible: RMS of weighted errors below which nothing is looked for, and by which thinning the records may move
            the nominal model's runs; 1 is the noise and what any good model misses.
        lost: normalised RMSE of the best effect's free runs from which these have lost the records, so that shorter
            ones are tried, and
        lost_refit: that of the re-fitted nominal model, of a robot's joint, too.
        followed: RMS of the best effect's errors, in noises, up to which free runs follow the records whatever they
            leave: nothing has added up along them.
        wrong_values: ratio of nominal to re-fitted RMS error from which the parameter values were wrong.
        max_relative_std: smallest relative standard error of any combination of parameters from which the records are
            too short to identify an effect.
        least_probability: below which no effect is asserted.
        base_rate: probability that any one effect of the catalogue is at work where something structural is left:
            a real machine lacks several. Chosen on twelve generated machines.
        left_worth: independent errors that what a model leaves is worth, where it is structural: neighbouring ones go
            together, and so do those of one record. Chosen with it.
        fall_slope: by how much the log-odds that an effect is at work grow as its fall grows by what it needs.
        retry_cost: ratio of the cost with an effect, beside another one, to the cost without it, below which it is
            tried beside two others.
        too_few: independent samples below which no effect can be identified.
        negligible_structure: RMS of autocorrelated errors of per-record fits up to which these say nothing: encoders
            whose counts rest, ripple or miss leave as much.
        between_records: variance of the records' own parameter values along a direction, over that of their estimation
            errors, from which the records differ along it.
        least_information: eigenvalue of the information on relative parameter changes, over the greatest, below which
            records do not identify a direction.
        place_z: standard errors by which a torque at another joint or side has to explain less, for a place to be
            named.
    """

    false_alarms: float = 0.05
    wrong_names: float = 0.2
    least_fall: float = 0.03
    next_fall: float = 0.25
    completing_fall: float = 0.1
    distinct_fall: float = 0.11
    distinct_z: float = 2.5
    major_share: float = 0.5
    autocorrelation_left: float = 0.5
    left_open: float = 0.1
    substantial: float = 0.1
    white: float = 0.1
    coloured: float = 0.3
    negligible: float = 0.1
    lost: float = 0.1
    lost_refit: float = 0.5
    followed: float = 3.0
    wrong_values: float = 1.1
    max_relative_std: float = 0.1
    least_probability: float = 0.5
    base_rate: float = 0.1
    left_worth: float = 30.0
    fall_slope: float = 8.0
    retry_cost: float = 0.99
    too_few: float = 30.0
    negligible_structure: float = 0.5
    between_records: float = 4.0
    least_information: float = 1e-6
    place_z: float = 3.0


CRITERIA = Criteria()
