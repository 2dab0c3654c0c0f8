"""Prediction errors and smoothed states are those of the dense Gaussian that they are a short way to."""

import kalman
import pytest
import torch
from kalman import Maps, predict, smooth

ROWS, SAMPLES, STATES, OUTPUTS, COLUMNS = 2, 12, 3, 2, 3


def maps() -> Maps:
    generator = torch.Generator().manual_seed(1)

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(ROWS, *shape, generator=generator, dtype=torch.float64)

    noise = 0.1 + draw(SAMPLES, OUTPUTS).square()
    noise[0, 3, 1] = noise[1, 5:, 0] = 0.0  # not measured
    root = draw(STATES, STATES)
    return Maps(
        0.6 * draw(SAMPLES, STATES, STATES), draw(SAMPLES, STATES, COLUMNS), draw(SAMPLES, STATES).square(),
        draw(SAMPLES, OUTPUTS, STATES), draw(SAMPLES, OUTPUTS, COLUMNS), noise,
        draw(STATES, COLUMNS), root @ root.transpose(1, 2),
    )  # fmt: skip


@pytest.mark.parametrize("compiled", [True, False])
def test_filter_and_smoother_are_the_dense_gaussian(compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not compiled:
        monkeypatch.setattr(kalman, "_code", lambda _: None)
    known, eta = maps(), torch.tensor([0.3, -0.7], dtype=torch.float64)
    found = predict(known, keep=True)
    states, variances = smooth(known, found, eta)
    weights = torch.cat([eta.new_ones(1), eta])
    for row in range(ROWS):
        # all states as linear in the first and in the noise of each step
        mean, spread = [known.mean[row] @ weights], [torch.linalg.cholesky(known.covariance[row])]
        for k in range(SAMPLES - 1):
            a, pushed = known.a[row, k], torch.diag(known.q[row, k].sqrt())
            mean.append(a @ mean[-1] + known.b[row, k] @ weights)
            spread = [*spread[:-1], spread[-1], torch.cat([a @ spread[-1], pushed], 1)]
        width = spread[-1].shape[1]
        whole = torch.cat([torch.nn.functional.pad(part, (0, width - part.shape[1])) for part in spread])
        prior = whole @ whole.T
        c = torch.block_diag(*known.c[row])
        seen = (known.noise[row] > 0).flatten()
        c, r = c[seen], known.noise[row].flatten()[seen]
        left = (known.e[row] @ weights).flatten()[seen] - c @ torch.cat(mean)
        variance = c @ prior @ c.T + torch.diag(r)
        quadratic = left @ torch.linalg.solve(variance, left)
        torch.testing.assert_close((found.errors[row] @ weights).square().sum(), quadratic)
        torch.testing.assert_close(found.log_variance[row], torch.logdet(variance))
        gain = torch.linalg.solve(variance, c @ prior).T
        torch.testing.assert_close(states[row].flatten(), torch.cat(mean) + gain @ left)
        torch.testing.assert_close(variances[row].flatten(), (prior - gain @ c @ prior).diagonal())
