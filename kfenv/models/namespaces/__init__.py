"""The arithmetic a model runs on.

A model is written once, with ``+ - * /`` and the few functions below, and is
given one of these modules when it is built:

=========== =====================================================
`scalar`    Python floats
`batch`     NumPy arrays, one element per filter
`compiled`  Numba, for the fused engine
`dual`      values with exact first derivatives (Jacobians)
`tensor`    torch tensors with gradients (needs torch)
=========== =====================================================

Each offers ``sqrt, sin, cos, atan2, exp, log, maximum, minimum`` and ``function``, the
decorator that every function inside a model's ``build`` carries; powers are whole numbers.
`tensor` alone offers ``gram`` as well, by which a model may do at once what elsewhere is a loop.
"""
