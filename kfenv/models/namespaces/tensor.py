"""torch tensors, with gradients. Needs torch, which kfenv itself never imports."""

import torch
from torch import cos, exp, log, sin, sqrt


def atan2(y, x):
    """Angle of (x, y); either may be a number."""
    return torch.atan2(torch.as_tensor(y), torch.as_tensor(x))


def maximum(a, b):
    """The larger of a and b; either may be a number."""
    if isinstance(a, torch.Tensor) and isinstance(b, torch.Tensor):
        return torch.maximum(a, b)
    if isinstance(a, torch.Tensor):
        return torch.clamp(a, min=b)  # no tensor is made of the number
    return torch.clamp(torch.as_tensor(b, dtype=torch.float64), min=a)


def minimum(a, b):
    """The smaller of a and b; either may be a number."""
    if isinstance(a, torch.Tensor) and isinstance(b, torch.Tensor):
        return torch.minimum(a, b)
    if isinstance(a, torch.Tensor):
        return torch.clamp(a, max=b)
    return torch.clamp(torch.as_tensor(b, dtype=torch.float64), max=a)


def function(f):
    """Leave the function as it is: torch traces it."""
    return f


def gram(table, x, y):
    """Sum over i of v_i v_i^T, where v_i is a polynomial in x and y, row by row as tuples.

    An operation costs a tensor the more, the smaller it is; this is half a dozen of them.

    Args:
        table: NumPy array (nodes, rows, powers of x, powers of y) of the coefficients.
        x, y: components.
    """
    nodes, rows, *powers = table.shape
    coefficients = torch.as_tensor(table.reshape(nodes * rows, -1), dtype=x.dtype, device=x.device)
    in_x, in_y = (
        base[..., None] ** torch.arange(count, dtype=x.dtype, device=x.device)
        for base, count in zip((x, y), powers, strict=True)
    )
    monomials = (in_x[..., :, None] * in_y[..., None, :]).flatten(-2)
    v = (monomials @ coefficients.mT).unflatten(-1, (nodes, rows))
    return tuple(row.unbind(-1) for row in (v.mT @ v).unbind(-2))


__all__ = ["atan2", "cos", "exp", "function", "gram", "log", "maximum", "minimum", "sin", "sqrt"]
