"""Estimates of the twin's campaigns against each run's own truth and against the paper's printed figures."""

import numpy as np

from hybrid_id.paper.comparison import PRINTED
from hybrid_id.paper.stages import truth_fits

PAPER = {name: percent for name, (percent, _) in PRINTED["link1"].parameters.items()}
"""Table 2, std/mean in %."""

CLAIMS = """
claim                                                     target      seen
without priors: combinations within 3 σ                   all         {a_within:.4f} of {a_scored:.0f}, {a_largest:.2f}
without priors: std/mean, worst combination               < 3 %       {a_percent:.2f} %
without priors: std/mean, worst Stribeck speed            < 5 %       {a_speed_percent:.2f} %
without priors: 95 % intervals that cover                 90-99 %     {a_cover:.1f} %
with priors: parameters within 3 σ                        all         {b_within:.4f} of {b_scored:.0f}, {b_largest:.2f}
with priors: rows below Table 2, not held by a prior      all         {b_below} of {b_rows}
with priors: 95 % intervals that cover                    90-99 %     {b_cover:.1f} %
engine error by step halving, standard errors             < 0.3       {b_engine:.3f}
cross-validated fit, position / velocity                  93.4/95.3   {b_position:.2f} / {b_velocity:.2f}
the same with the truth of each run for its estimate      1 point     {b_truth_position:.2f} / {b_truth_velocity:.2f}"""


class Campaign:
    """Collects studies of one variant over seeds: of each parameter, or of what is identified without priors."""

    def __init__(self, *, parameters):
        self.parameters = parameters
        self.z, self.percent, self.engine, self.fits, self.truth_fits = [], [], [], [], []
        self.names = self.rows = ()

    def add(self, config, study, truths, dataset):
        """Scores one study: z of each claimed quantity (sets, k), std/mean, fits of the selected set."""
        told = study.identifiability
        truth = np.array([[run[name] for name in study.names] for run in truths])
        errors = [
            np.maximum(p.std_error, r.std_error) for p, r in zip(study.covariances, study.robust, strict=True)
        ]
        if self.parameters:
            self.names = study.names
            values, target = study.values, truth
            errors = np.where(told.claimable, errors, np.nan)  # no interval, nothing to score
        else:
            self.names = tuple(c.text for c in told.combinations)
            values = np.stack([c.evaluate(study.values) for c in told.combinations], 1)
            target = np.stack([c.evaluate(truth) for c in told.combinations], 1)
            errors = [
                [max(c.std_error(v, p.matrix), c.std_error(v, r.matrix)) for c in told.combinations]
                for v, p, r in zip(study.values, study.covariances, study.robust, strict=True)
            ]
        self.held = told.prior_share > 0.5
        self.z.append((values - target) / np.array(errors))
        self.percent.append(100 * values.std(0, ddof=1) / np.abs(values.mean(0)))
        self.engine.append(study.engine_error)
        chosen = study.selection.index
        self.fits.append(study.cross_validation.fits[chosen].mean(0))
        self.truth_fits.append(truth_fits(config, dataset, truths, chosen, ("q_m1", "v_m1")).mean(0))

    def report(self, name):
        """Prints the table of the variant and returns its figures."""
        z, percent = np.concatenate(self.z), np.mean(self.percent, 0)
        print(
            f"\n{name}: mean over {len(self.z)} seeds\n{'':18} std/mean %   Table 2 %   rms z   |z| max   cover %"
        )
        for k, quantity in enumerate(self.names):
            printed = f"{PAPER[quantity]:10.2f}" if quantity in PAPER else " " * 10
            cover = 100 * _share(z[:, k], 1.96)
            print(
                f"{quantity:18} {percent[k]:10.3f} {printed}  {np.sqrt(np.nanmean(z[:, k] ** 2)):6.2f} "
                f"{np.nanmax(np.abs(z[:, k])):9.2f} {cover:9.1f}"
            )
        speeds = np.array([quantity in ("f_13", "f_14", "f_23", "f_24") for quantity in self.names])
        own = [n in PAPER and not held for n, held in zip(self.names, self.held, strict=False)]
        below = sum(percent[k] < PAPER[self.names[k]] for k in np.flatnonzero(own))
        position, velocity = np.mean(self.fits, 0)
        truth_position, truth_velocity = np.mean(self.truth_fits, 0)
        figures = {
            "within": _share(z, 3.0), "largest": np.nanmax(np.abs(z)), "cover": 100 * _share(z, 1.96),
            "scored": np.isfinite(z).sum(),
            "percent": percent[~speeds].max(), "speed_percent": percent[speeds].max(), "engine": max(self.engine),
            "position": position, "velocity": velocity,
            "truth_position": truth_position, "truth_velocity": truth_velocity,
        }  # fmt: skip
        return {key: round(float(value), 4) for key, value in figures.items()} | {
            "below": int(below),
            "rows": sum(own),
        }


def _share(z, limit):
    """Share of the errors that were scored within so many standard errors."""
    return np.mean(np.abs(z[np.isfinite(z)]) < limit)
