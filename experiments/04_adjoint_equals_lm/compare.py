"""Two lists of results, record by record, in standard errors of the first."""

import numpy as np

from hybrid_id.statistics.identifiability import identifiability
from hybrid_id.statistics.uncertainty import covariance
from hybrid_id.statistics.variation import variation


class Comparison:
    """Estimates of Levenberg-Marquardt and of the adjoint, and what the records tell apart.

    Args:
        fitted, trained: one result a record.
        seconds: processor time of both.
    """

    def __init__(self, fitted, trained, seconds):
        self.fitted, self.trained, self.seconds = fitted, trained, seconds
        names = fitted[0].names
        told = [
            identifiability(
                r.values,
                names,
                jacobian=r.jacobian,
                prior_precision=r.prior_precision,
                references=("P_m1",),
            )
            for r in fitted
        ]
        covs = [covariance(r.jacobian, r.residual, prior_precision=r.prior_precision) for r in fitted]
        sets = [np.array([r.values for r in results]) for results in (fitted, trained)]
        if all(t.claimable.all() for t in told):
            self.names, self.values = names, sets
            errors = np.array([np.sqrt(np.diag(c.matrix)) for c in covs])
        else:  # what the records do not tell apart is compared through what they do
            combinations = told[0].combinations
            self.names = tuple(c.text for c in combinations)
            self.values = [np.stack([c.evaluate(s) for c in combinations], 1) for s in sets]
            errors = np.array(
                [
                    [c.std_error(r.values, v.matrix) for c in combinations]
                    for r, v in zip(fitted, covs, strict=True)
                ]
            )
        self.z = (self.values[1] - self.values[0]) / errors

    def table(self):
        """Mean and std/mean by both methods, and the largest difference over the records."""
        one, two = (variation(v, self.names) for v in self.values)
        lines = [f"{'':20} {'mean LM':>12} {'adjoint':>12}   std/mean LM   adjoint   largest difference [σ]"]
        for k, name in enumerate(self.names):
            lines.append(
                f"{name:20} {one.mean[k]:12.5g} {two.mean[k]:12.5g} {one.percent[k]:11.3f} % {two.percent[k]:7.3f} %"
                f"   {np.abs(self.z[:, k]).max():10.4f}"
            )
        gradients = [r.iterations for r in self.trained]
        lines += [
            f"{len(self.trained)} records, {sum(r.status == 'converged' for r in self.trained)} converged, "
            f"{min(gradients)}-{max(gradients)} adjoint gradients a record",
            f"processor time: Levenberg-Marquardt {self.seconds[0]:.1f} s, adjoint {self.seconds[1]:.1f} s",
        ]
        return "\n".join(lines)

    def summary(self):
        """The figures that the claims are about."""
        one, two = (variation(v, self.names) for v in self.values)
        return {
            "largest_difference": float(np.abs(self.z).max()),
            "std_mean_percent": {
                n: [float(a), float(b)] for n, a, b in zip(self.names, one.percent, two.percent, strict=True)
            },
            "gradients": [r.iterations for r in self.trained],
            "status": [r.status for r in self.trained],
            "seconds": list(self.seconds),
        }
