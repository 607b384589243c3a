"""Test the residuals of the equations after the search, without a known cause.

Each module tests one property of the residual: size (`adequacy`, `louder`),
frequency (`adequacy`, `orders`), other signals (`pairs`), or change from segment to
segment (`courses`). The answers are `Structure`s, or `Question`s that `fit.chance` judges together.
Modules here call `search`, `fit` and `equations`, and change nothing there.
"""
