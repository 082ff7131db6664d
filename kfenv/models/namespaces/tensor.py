"""torch tensors, with gradients. Needs torch, which kfenv itself never imports."""

import torch
from torch import cos, sin, sqrt


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


def gram(table, values):
    """Sum over i of (A_i v)(A_i v)^T for constant matrices A_i, row by row as tuples.

    An operation costs a tensor the more, the smaller it is; this is three of them.

    Args:
        table: NumPy array (nodes, rows, len(values)) of the A_i.
        values: the components of v.
    """
    v = torch.stack(values, dim=-1)
    nodes, rows, terms = table.shape
    flat = torch.as_tensor(table.reshape(-1, terms), dtype=v.dtype, device=v.device)
    seen = (v @ flat.mT).unflatten(-1, (nodes, rows))
    return tuple(row.unbind(-1) for row in (seen.mT @ seen).unbind(-2))


__all__ = ["atan2", "cos", "function", "gram", "maximum", "minimum", "sin", "sqrt"]
