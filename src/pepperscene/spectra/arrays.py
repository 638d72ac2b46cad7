"""NumPy arrays and torch tensors through the same formulas: the namespace is that of what comes in."""

from __future__ import annotations

import sys
from typing import Any, TypeAlias

import numpy as np

Array: TypeAlias = Any
"""A NumPy array of float64, or a torch tensor of float64 wherever a tensor came in."""


def floats(*inputs: Array) -> tuple[Any, tuple[Array, ...]]:
    """The namespace (`numpy` or `torch`) of the inputs, and all of them as its float64 arrays.

    One tensor among the inputs makes all of them tensors on its device, differentiable as they were. Only the
    names that NumPy and torch share with one meaning may be taken from the namespace. torch is an optional
    package and is not imported here: whoever passes a tensor has done so.
    """
    torch = sys.modules.get("torch")
    tensors = [x for x in inputs if torch is not None and isinstance(x, torch.Tensor)]
    if torch is None or not tensors:
        return np, tuple(np.asarray(x, dtype=float) for x in inputs)
    device = tensors[0].device
    return torch, tuple(torch.as_tensor(x, dtype=torch.float64, device=device) for x in inputs)


def expn(order: int, x: Array) -> Array:
    """Exponential integral E_n(x) of x >= 0, by SciPy; E_n' = -E_(n-1) where a tensor asks for gradients."""
    if isinstance(x, (np.ndarray, np.floating)):
        from scipy.special import expn as scipy_expn

        return scipy_expn(order, x)
    from pepperscene.spectra.torch_integrals import ExponentialIntegral

    return ExponentialIntegral.apply(x, order)
