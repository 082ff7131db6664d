"""torch tensors, with gradients. Needs torch, which kfenv itself never imports."""

import torch
from torch import cos, sin, sqrt


def atan2(y, x):
    """Angle of (x, y); either may be a number."""
    return torch.atan2(torch.as_tensor(y), torch.as_tensor(x))


def maximum(a, b):
    """The larger of a and b; either may be a number."""
    return torch.maximum(torch.as_tensor(a), torch.as_tensor(b, dtype=torch.float64))


def minimum(a, b):
    """The smaller of a and b; either may be a number."""
    return torch.minimum(torch.as_tensor(a), torch.as_tensor(b, dtype=torch.float64))


def function(f):
    """Leave the function as it is: torch traces it."""
    return f


__all__ = ["atan2", "cos", "function", "maximum", "minimum", "sin", "sqrt"]
