"""Identification: objective, batched Levenberg-Marquardt, adjoint training, results."""
