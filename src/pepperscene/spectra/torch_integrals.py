"""The exponential integrals for torch, which has none; imported only when a tensor comes in."""

from __future__ import annotations

from typing import Any

import torch
from scipy.special import expn


class ExponentialIntegral(torch.autograd.Function):
    """E_n(x) of a float64 tensor x >= 0 and a whole n >= 1, differentiable as often as wanted for x > 0.

    d/dx E_n = -E_(n-1), with E_0 = exp(-x) / x (NIST Digital Library of Mathematical Functions, 8.19.13).
    At x = 0 E_3 has the slope -1, but E_2 an infinite one.
    """

    @staticmethod
    def forward(x: torch.Tensor, order: int) -> torch.Tensor:
        """E_n, computed by SciPy on the processor."""
        found = expn(order, x.detach().cpu().numpy())
        return torch.as_tensor(found, dtype=x.dtype, device=x.device)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[torch.Tensor, int], output: torch.Tensor) -> None:
        """Keep x for the slope, in reverse and in forward mode."""
        x, ctx.order = inputs
        ctx.save_for_backward(x)
        ctx.save_for_forward(x)

    @staticmethod
    def backward(ctx: Any, *upstream: torch.Tensor) -> tuple[torch.Tensor, None]:
        """Gradient by x."""
        (x,) = ctx.saved_tensors
        return upstream[0] * _slope(x, ctx.order), None

    @staticmethod
    def jvp(ctx: Any, *tangents: torch.Tensor) -> torch.Tensor:
        """Forward-mode derivative along the tangent of x."""
        (x,) = ctx.saved_tensors
        return tangents[0] * _slope(x, ctx.order)

    @staticmethod
    def vmap(info: Any, in_dims: tuple[int, None], x: torch.Tensor, order: int) -> tuple[torch.Tensor, int]:
        """Element by element, so that a batch is one more axis."""
        return ExponentialIntegral.apply(x, order), in_dims[0]


def _slope(x: torch.Tensor, order: int) -> torch.Tensor:
    return -torch.exp(-x) / x if order == 1 else -ExponentialIntegral.apply(x, order - 1)
